#include "polygons.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace parhelion {
namespace {

struct Point {
  double x, y;
};

// Twice the area of a triangle; positive where it turns to the left.
double turn(Point a, Point b, Point c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

bool within(Point p, Point a, Point b, Point c) {
  return turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
}

bool same(Point a, Point b) { return a.x == b.x && a.y == b.y; }

// A corner that lies inside by less than this part of the coordinates' size is none: on a disk of
// many corners every other one does by rounding.
constexpr double kFlat = 2e-7;

class Cutter {
 public:
  void cut(const double* vertices, const u32* corners, u32 first, u32 n, std::vector<u32>& out) {
    if (n == 3 || convex(vertices, corners, n)) {
      for (u32 i = 1; i + 1 < n; ++i) emit(first, 0, i, i + 1, out);
      return;
    }
    if (n > kMostCorners) {
      throw std::length_error("has " + std::to_string(n) + " corners and is not convex; at most " +
                              std::to_string(kMostCorners) + " are read of such a one");
    }
    previous_.resize(n);
    next_.resize(n);
    for (u32 i = 0; i < n; ++i) previous_[i] = i == 0 ? n - 1 : i - 1, next_[i] = (i + 1) % n;
    u32 left = n, tried = 0, at = 0;
    while (left > 3) {
      // Where there is no ear, as the outline crosses itself, any corner is cut off.
      if (tried < left && !ear(at)) {
        at = next_[at];
        ++tried;
        continue;
      }
      emit(first, previous_[at], at, next_[at], out);
      next_[previous_[at]] = next_[at];
      previous_[next_[at]] = previous_[at];
      at = next_[next_[at]];  // not next to the last, which would make a fan of slivers
      --left;
      tried = 0;
    }
    emit(first, previous_[at], at, next_[at], out);
  }

 private:
  static void emit(u32 first, u32 a, u32 b, u32 c, std::vector<u32>& out) {
    out.push_back(first + a);
    out.push_back(first + b);
    out.push_back(first + c);
  }

  // Projects the polygon along the axis that it faces most, to turn left; false if it turns both
  // ways, by more than the rounding of float coordinates may do.
  bool convex(const double* vertices, const u32* corners, u32 n) {
    double normal[3] = {0, 0, 0};
    for (u32 i = 0; i < n; ++i) {
      const double* p = vertices + size_t{3} * corners[i];
      const double* q = vertices + size_t{3} * corners[(i + 1) % n];
      for (int k = 0; k < 3; ++k) {
        const int u = (k + 1) % 3, v = (k + 2) % 3;
        normal[k] += (p[u] - q[u]) * (p[v] + q[v]);
      }
    }
    int axis = 0;
    for (int k = 1; k < 3; ++k) {
      if (std::abs(normal[k]) > std::abs(normal[axis])) axis = k;
    }
    const bool back = normal[axis] < 0.0;
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    points_.resize(n);
    double extent = 0.0;
    for (u32 i = 0; i < n; ++i) {
      const double* p = vertices + size_t{3} * corners[i];
      points_[i] = back ? Point{p[v], p[u]} : Point{p[u], p[v]};
      extent = std::max({extent, std::abs(p[u]), std::abs(p[v])});
    }
    for (u32 i = 0; i < n; ++i) {
      const Point a = points_[i], b = points_[(i + 1) % n], c = points_[(i + 2) % n];
      const double dent = kFlat * extent * std::hypot(c.x - a.x, c.y - a.y);
      if (turn(a, b, c) < -dent) return false;
    }
    return true;
  }

  bool ear(u32 i) const {
    const Point a = points_[previous_[i]], b = points_[i], c = points_[next_[i]];
    if (turn(a, b, c) <= 0.0) return false;
    for (u32 k = next_[next_[i]]; k != previous_[i]; k = next_[k]) {
      const Point p = points_[k];
      if (within(p, a, b, c) && !same(p, a) && !same(p, b) && !same(p, c)) return false;
    }
    return true;
  }

  std::vector<Point> points_;
  std::vector<u32> previous_, next_;
};

}  // namespace

std::vector<u32> triangulate(const double* vertices, const u32* counts, u32 polygon_count,
                             const u32* corners) {
  std::vector<u32> out;
  Cutter cutter;
  u32 first = 0;
  for (u32 p = 0; p < polygon_count; ++p) {
    try {
      cutter.cut(vertices, corners + first, first, counts[p], out);
    } catch (const std::length_error& e) {
      throw std::length_error("face " + std::to_string(p) + " " + e.what());
    }
    first += counts[p];
  }
  return out;
}

}  // namespace parhelion
