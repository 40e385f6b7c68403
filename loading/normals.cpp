#include "normals.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>

#include "../core/special.h"
#include "../host/threads.h"

namespace parhelion {
namespace {

struct Face {
  Vec3 normal;      // of length 1, or 0 without an area
  float angles[3];  // at the corners, radians
};

// Faces that are measured at once: angles in loops without branches, which would go either way as
// often.
constexpr u32 kBatch = 16;

template <class Real>
void measure_batch(const Real* vertices, const u32* faces, u32 count, Face* found) {
  float across[2][kBatch] = {}, along[2][kBatch] = {}, angles[2][kBatch];
  for (u32 f = 0; f < count; ++f) {
    double edges[3][3];  // from each corner to the next
    for (int i = 0; i < 3; ++i) {
      const Real* from = vertices + size_t{3} * faces[size_t{3} * f + i];
      const Real* to = vertices + size_t{3} * faces[size_t{3} * f + (i + 1) % 3];
      for (int k = 0; k < 3; ++k) edges[i][k] = double(to[k]) - double(from[k]);
    }
    const double* a = edges[0];
    const double* b = edges[1];
    const double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                         a[0] * b[1] - a[1] * b[0]};
    const double area = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    const double unit = area == 0.0 ? 0.0 : 1.0 / area;
    found[f].normal = {float(n[0] * unit), float(n[1] * unit), float(n[2] * unit)};
    for (int i = 0; i < 2; ++i) {
      // The sine and the cosine of the angle, both times the lengths of its two edges
      const double* out = edges[i];
      const double* in = edges[(i + 2) % 3];
      const double cosine = -(out[0] * in[0] + out[1] * in[1] + out[2] * in[2]);
      const double scale = std::max(area, std::abs(cosine));
      const double inverse = scale == 0.0 ? 0.0 : 1.0 / scale;
      across[i][f] = float(area * inverse), along[i][f] = float(cosine * inverse);
    }
  }
  for (int i = 0; i < 2; ++i) {
    for (u32 f = 0; f < kBatch; ++f) angles[i][f] = baseline::atan2(across[i][f], along[i][f]);
  }
  for (u32 f = 0; f < count; ++f) {
    const float a = angles[0][f], b = angles[1][f];
    found[f].angles[0] = a, found[f].angles[1] = b;
    found[f].angles[2] = std::max(0.0f, kPi - a - b);
  }
}

template <class Real>
std::vector<Face> measure(const Real* vertices, const u32* faces, u32 face_count) {
  std::vector<Face> found(face_count);
#pragma omp parallel for schedule(static) if (face_count > kFewElements)
  for (u32 f = 0; f < face_count; f += kBatch) {
    const u32 count = std::min(kBatch, face_count - f);
    measure_batch(vertices, faces + size_t{3} * f, count, &found[f]);
  }
  return found;
}

// The corners at each vertex, in the order of the file.
struct Corners {
  std::vector<u32> begin;  // of each vertex in `at`, and the end
  std::vector<u32> at;

  Corners(u32 vertex_count, const u32* faces, u32 face_count)
      : begin(size_t{vertex_count} + 1), at(size_t{3} * face_count) {
    for (size_t c = 0; c < at.size(); ++c) {
      if (faces[c] >= vertex_count) {
        throw std::out_of_range("face " + std::to_string(c / 3) + " refers to vertex " +
                                std::to_string(faces[c]) + "; there are " +
                                std::to_string(vertex_count));
      }
      ++begin[faces[c]];
    }
    // As ends, which move down to begins while they are filled from the last corner on
    std::inclusive_scan(begin.begin(), begin.end(), begin.begin());
    for (size_t c = at.size(); c-- > 0;) at[--begin[faces[c]]] = static_cast<u32>(c);
  }
};

// The sum of normals, each times the angle of its face's corner.
struct Sum {
  double x = 0, y = 0, z = 0;

  void add(const Face& face, u32 at) {
    const double angle = face.angles[at];
    x += angle * face.normal.x, y += angle * face.normal.y, z += angle * face.normal.z;
  }
  Vec3 direction() const {
    const double length = std::sqrt(x * x + y * y + z * z);
    return length < 1e-6 ? Vec3{1, 0, 0}
                         : Vec3{float(x / length), float(y / length), float(z / length)};
  }
};

// Finds which corners at a vertex belong together.
class Joiner {
 public:
  // crease: radians. most: corners at a vertex; nothing is allocated later, where threads run.
  Joiner(const u32* faces, const std::vector<Face>& measured, double crease, u32 most)
      : faces_(faces),
        measured_(measured),
        cos_(static_cast<float>(std::cos(crease))),
        cos_half_(static_cast<float>(std::cos(0.5 * crease))),
        edges_(size_t{2} * most),
        normals_(most),
        parent_(most),
        beside_(most) {}

  // Writes to part[c] the part of each of n corners c, from 0 by the first of each, where there are
  // several; returns their number.
  u32 join(const u32* corners, u32 n, u32* part) {
    if (near(corners, n)) return n > 0;
    for (u32 i = 0; i < n; ++i) {
      const u32 c = corners[i], face = c / 3, at = c % 3;
      const u32* v = faces_ + size_t{3} * face;
      edges_[2 * i] = u64{v[at == 2 ? 0 : at + 1]} << 32 | i;
      edges_[2 * i + 1] = u64{v[at == 0 ? 2 : at - 1]} << 32 | i;
      normals_[i] = measured_[face].normal;
      parent_[i] = i;
      beside_[i] = kNone;
    }
    std::sort(edges_.data(), edges_.data() + 2 * n);
    for (u32 e = 1; e < 2 * n; ++e) {
      if (edges_[e] >> 32 != edges_[e - 1] >> 32) continue;
      const u32 i = static_cast<u32>(edges_[e - 1]), j = static_cast<u32>(edges_[e]);
      if (flat(normals_[i])) {
        pass(i, j);
      } else if (flat(normals_[j])) {
        pass(j, i);
      } else if (baseline::dot(normals_[i], normals_[j]) > cos_) {
        unite(i, j);
      }
    }
    u32 parts = 0;
    for (u32 i = 0; i < n; ++i) {
      const u32 r = root(i);  // never after i
      part[corners[i]] = r == i ? parts++ : part[corners[r]];
    }
    return parts;
  }

 private:
  // Of a face without an area.
  static bool flat(Vec3 normal) { return normal.x == 0 && normal.y == 0 && normal.z == 0; }

  // A face without an area lets the surface pass: its two neighbours count as each other's.
  void pass(u32 sliver, u32 other) {
    u32& first = beside_[sliver];
    if (first == kNone) {
      first = other;
      unite(sliver, other);
    } else if (baseline::dot(normals_[first], normals_[other]) > cos_) {
      unite(sliver, other);
    }
  }

  // Whether all faces lie within half the crease of the first, as around most vertices.
  bool near(const u32* corners, u32 n) const {
    for (u32 i = 1; i < n; ++i) {
      if (!(baseline::dot(measured_[corners[i] / 3].normal, measured_[corners[0] / 3].normal) >
            cos_half_)) {
        return false;
      }
    }
    return true;
  }

  u32 root(u32 i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void unite(u32 i, u32 j) {
    i = root(i), j = root(j);
    parent_[std::max(i, j)] = std::min(i, j);
  }

  const u32* faces_;
  const std::vector<Face>& measured_;
  float cos_, cos_half_;
  // Of the vertex at hand: the other end of each edge, above the place of the corner it is at
  std::vector<u64> edges_;
  std::vector<Vec3> normals_;  // of the corners' faces
  std::vector<u32> parent_;
  std::vector<u32> beside_;  // of corners of faces without an area: a neighbour
};

}  // namespace

template <class Real>
ShadedMesh shade(const Real* vertices, u32 vertex_count, const u32* faces, u32 face_count,
                 std::optional<double> crease) {
  const Corners corners(vertex_count, faces, face_count);
  const std::vector<Face> measured = measure(vertices, faces, face_count);
  const bool many = face_count > kFewElements;
  const size_t threads = many ? static_cast<size_t>(omp_get_max_threads()) : 1;
  u32 most = 0;  // corners at a vertex
  for (u32 v = 0; v < vertex_count; ++v) {
    most = std::max(most, corners.begin[v + 1] - corners.begin[v]);
  }
  const double radians = crease.value_or(0.0) * (3.14159265358979323846 / 180);
  std::vector<Joiner> joiners(threads, Joiner(faces, measured, radians, most));

  ShadedMesh mesh;
  mesh.faces.resize(corners.at.size());              // of each corner, for now, its part
  std::vector<u32> first(size_t{vertex_count} + 1);  // vertex of the result, of each vertex's parts
  std::vector<Vec3> normals(vertex_count);           // of vertices that are one part, as most are
#pragma omp parallel if (many)
  {
    Joiner& joiner = joiners[omp_get_thread_num()];
#pragma omp for schedule(static)
    for (u32 v = 0; v < vertex_count; ++v) {
      const u32* at = corners.at.data() + corners.begin[v];
      const u32 n = corners.begin[v + 1] - corners.begin[v];
      first[v] = crease ? joiner.join(at, n, mesh.faces.data()) : 1;
      if (first[v] != 1) continue;
      Sum sum;
      for (u32 i = 0; i < n; ++i) sum.add(measured[at[i] / 3], at[i] % 3);
      normals[v] = sum.direction();
    }
  }
  std::exclusive_scan(first.begin(), first.end(), first.begin(), 0u);

  mesh.old.resize(first[vertex_count]);
  mesh.normals.resize(first[vertex_count]);
  std::vector<std::vector<Sum>> room(threads, std::vector<Sum>(most));
#pragma omp parallel if (many)
  {
#pragma omp for schedule(static)
    for (u32 v = 0; v < vertex_count; ++v) {
      const u32 begin = first[v], parts = first[v + 1] - begin;
      std::fill_n(mesh.old.begin() + begin, parts, v);
      if (parts == 1) {
        mesh.normals[begin] = normals[v];
        continue;
      }
      std::vector<Sum>& sums = room[omp_get_thread_num()];
      std::fill_n(sums.begin(), parts, Sum{});
      for (u32 k = corners.begin[v]; k < corners.begin[v + 1]; ++k) {
        const u32 c = corners.at[k];
        sums[mesh.faces[c]].add(measured[c / 3], c % 3);
      }
      for (u32 p = 0; p < parts; ++p) mesh.normals[begin + p] = sums[p].direction();
    }
#pragma omp for schedule(static)
    for (size_t c = 0; c < mesh.faces.size(); ++c) mesh.faces[c] += first[faces[c]];
  }
  return mesh;
}

template ShadedMesh shade(const float*, u32, const u32*, u32, std::optional<double>);
template ShadedMesh shade(const double*, u32, const u32*, u32, std::optional<double>);

}  // namespace parhelion
