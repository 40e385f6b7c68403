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

struct Geometry {
  std::vector<Vec3> normals;  // of each face, 0 without an area
  std::vector<float> angles;  // of each corner, radians
};

template <class Real>
Geometry measure(const Real* vertices, const u32* faces, u32 face_count) {
  Geometry found{std::vector<Vec3>(face_count), std::vector<float>(size_t{3} * face_count)};
#pragma omp parallel for schedule(static) if (face_count > kFewElements)
  for (u32 f = 0; f < face_count; ++f) {
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
    found.normals[f] = {float(n[0] * unit), float(n[1] * unit), float(n[2] * unit)};
    float* angles = &found.angles[size_t{3} * f];
    for (int i = 0; i < 2; ++i) {
      // The sine and the cosine of the angle, both times the lengths of its two edges
      const double* out = edges[i];
      const double* in = edges[(i + 2) % 3];
      const double along = -(out[0] * in[0] + out[1] * in[1] + out[2] * in[2]);
      const double scale = std::max(area, std::abs(along));
      const double inverse = scale == 0.0 ? 0.0 : 1.0 / scale;
      angles[i] = baseline::atan2(float(area * inverse), float(along * inverse));
    }
    angles[2] = std::max(0.0f, kPi - angles[0] - angles[1]);
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

// Finds which corners at a vertex belong together.
class Joiner {
 public:
  // crease: radians. most: corners at a vertex; nothing is allocated later, where threads run.
  Joiner(const u32* faces, const std::vector<Vec3>& normals, double crease, u32 most)
      : faces_(faces),
        face_normals_(normals),
        cos_(static_cast<float>(std::cos(crease))),
        cos_half_(static_cast<float>(std::cos(0.5 * crease))),
        edges_(size_t{2} * most),
        normals_(most),
        parent_(most),
        beside_(most) {}

  // Writes the part of each of the n corners, from 0 by the first of each; returns their number.
  u32 join(const u32* corners, u32 n, u32* part) {
    if (near(corners, n)) {
      std::fill(part, part + n, 0u);
      return n > 0;
    }
    for (u32 i = 0; i < n; ++i) {
      const u32 c = corners[i], face = c / 3, at = c % 3;
      const u32* v = faces_ + size_t{3} * face;
      edges_[2 * i] = u64{v[at == 2 ? 0 : at + 1]} << 32 | i;
      edges_[2 * i + 1] = u64{v[at == 0 ? 2 : at - 1]} << 32 | i;
      normals_[i] = face_normals_[face];
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
      part[i] = r == i ? parts++ : part[r];
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
      if (!(baseline::dot(face_normals_[corners[i] / 3], face_normals_[corners[0] / 3]) >
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
  const std::vector<Vec3>& face_normals_;
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
  const Geometry geometry = measure(vertices, faces, face_count);
  const bool many = face_count > kFewElements;
  const size_t threads = many ? static_cast<size_t>(omp_get_max_threads()) : 1;
  u32 most = 0;  // corners at a vertex
  for (u32 v = 0; v < vertex_count; ++v) {
    most = std::max(most, corners.begin[v + 1] - corners.begin[v]);
  }

  std::vector<u32> part(corners.at.size());          // of each of corners.at
  std::vector<u32> first(size_t{vertex_count} + 1);  // vertex of the result, of each vertex's parts
  if (crease) {
    const double radians = *crease * (3.14159265358979323846 / 180);
    std::vector<Joiner> joiners(threads, Joiner(faces, geometry.normals, radians, most));
#pragma omp parallel if (many)
    {
      Joiner& joiner = joiners[omp_get_thread_num()];
#pragma omp for schedule(static)
      for (u32 v = 0; v < vertex_count; ++v) {
        const u32 begin = corners.begin[v];
        first[v] = joiner.join(corners.at.data() + begin, corners.begin[v + 1] - begin,
                               part.data() + begin);
      }
    }
  } else {
    std::fill(first.begin(), first.end() - 1, 1u);
  }
  std::exclusive_scan(first.begin(), first.end(), first.begin(), 0u);

  const u32 count = first[vertex_count];
  ShadedMesh mesh{std::vector<u32>(corners.at.size()), std::vector<u32>(count),
                  std::vector<Vec3>(count)};
  std::vector<std::vector<double>> room(threads, std::vector<double>(size_t{3} * (most + 1)));
#pragma omp parallel if (many)
  {
    std::vector<double>& sums = room[omp_get_thread_num()];
#pragma omp for schedule(static)
    for (u32 v = 0; v < vertex_count; ++v) {
      const u32 parts = first[v + 1] - first[v];
      std::fill(sums.begin(), sums.begin() + 3 * parts, 0.0);
      for (u32 k = corners.begin[v]; k < corners.begin[v + 1]; ++k) {
        const u32 corner = corners.at[k];
        const Vec3 normal = geometry.normals[corner / 3];
        const double angle = geometry.angles[corner];
        double* sum = &sums[size_t{3} * part[k]];
        sum[0] += angle * normal.x, sum[1] += angle * normal.y, sum[2] += angle * normal.z;
        mesh.faces[corner] = first[v] + part[k];
      }
      for (u32 p = 0; p < parts; ++p) {
        const double* sum = &sums[size_t{3} * p];
        const double length = std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
        mesh.old[first[v] + p] = v;
        mesh.normals[first[v] + p] =
            length < 1e-6
                ? Vec3{1, 0, 0}
                : Vec3{float(sum[0] / length), float(sum[1] / length), float(sum[2] / length)};
      }
    }
  }
  return mesh;
}

template ShadedMesh shade(const float*, u32, const u32*, u32, std::optional<double>);
template ShadedMesh shade(const double*, u32, const u32*, u32, std::optional<double>);

}  // namespace parhelion
