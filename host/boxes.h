// Boxes of primitives, and what is worked out of them three coordinates at once.
#pragma once
#include <algorithm>
#include <cmath>

#include "../core/types.h"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace parhelion {

struct Aabb {
  float low[3] = {INFINITY, INFINITY, INFINITY};
  float high[3] = {-INFINITY, -INFINITY, -INFINITY};

  void grow(const float (&p)[3]) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], p[k]);
      high[k] = std::max(high[k], p[k]);
    }
  }
};

// What the tree is built over: a primitive's box, its number in its group, and the user's shape
// that it belongs to.
struct Ref {
  float low[3];
  u32 id;
  float high[3];
  u32 shape;
};

// Three coordinates at once; the fourth lane means nothing.
#if defined(__SSE2__)
struct Point {
  __m128 v;
  static Point all(float x) { return {_mm_set1_ps(x)}; }
  // p[3] may be anything, so it is masked: arithmetic on what is no number may be slow.
  static Point of(const float* p) {
    const __m128i mask = _mm_set_epi32(0, -1, -1, -1);
    return {_mm_and_ps(_mm_loadu_ps(p), _mm_castsi128_ps(mask))};
  }
  void store(float (&p)[4]) const { _mm_storeu_ps(p, v); }
  void truncate(int (&p)[4]) const {
    _mm_storeu_si128(reinterpret_cast<__m128i*>(p), _mm_cvttps_epi32(v));
  }
  friend Point min(Point a, Point b) { return {_mm_min_ps(a.v, b.v)}; }
  friend Point max(Point a, Point b) { return {_mm_max_ps(a.v, b.v)}; }
  friend Point operator+(Point a, Point b) { return {_mm_add_ps(a.v, b.v)}; }
  friend Point operator-(Point a, Point b) { return {_mm_sub_ps(a.v, b.v)}; }
  friend Point operator*(Point a, Point b) { return {_mm_mul_ps(a.v, b.v)}; }
  // xy + yz + zx
  friend float sum_of_products(Point a) {
    const __m128 p = _mm_mul_ps(a.v, _mm_shuffle_ps(a.v, a.v, _MM_SHUFFLE(3, 0, 2, 1)));
    const __m128 first = _mm_add_ss(p, _mm_shuffle_ps(p, p, _MM_SHUFFLE(1, 1, 1, 1)));
    return _mm_cvtss_f32(_mm_add_ss(first, _mm_movehl_ps(p, p)));
  }
};
#else
struct Point {
  float v[4];
  static Point all(float x) { return {{x, x, x, x}}; }
  static Point of(const float* p) { return {{p[0], p[1], p[2], 0.0f}}; }
  void store(float (&p)[4]) const { std::copy(v, v + 4, p); }
  void truncate(int (&p)[4]) const {
    for (int k = 0; k < 4; ++k) p[k] = static_cast<int>(v[k]);
  }
  template <class F>
  static Point each(Point a, Point b, F f) {
    for (int k = 0; k < 4; ++k) a.v[k] = f(a.v[k], b.v[k]);
    return a;
  }
  friend Point min(Point a, Point b) {
    return each(a, b, [](float x, float y) { return x < y ? x : y; });
  }
  friend Point max(Point a, Point b) {
    return each(a, b, [](float x, float y) { return x > y ? x : y; });
  }
  friend Point operator+(Point a, Point b) {
    return each(a, b, [](float x, float y) { return x + y; });
  }
  friend Point operator-(Point a, Point b) {
    return each(a, b, [](float x, float y) { return x - y; });
  }
  friend Point operator*(Point a, Point b) {
    return each(a, b, [](float x, float y) { return x * y; });
  }
  // xy + yz + zx
  friend float sum_of_products(Point a) {
    return a.v[0] * a.v[1] + a.v[1] * a.v[2] + a.v[2] * a.v[0];
  }
};
#endif

inline Point center_of(const Ref& r) {
  return (Point::of(r.low) + Point::of(r.high)) * Point::all(0.5f);
}
inline float center_of(const Ref& r, int axis) { return 0.5f * (r.low[axis] + r.high[axis]); }

// A box that grows.
struct Extent {
  Point low = Point::all(INFINITY), high = Point::all(-INFINITY);

  void grow(Point p) {
    low = min(low, p);
    high = max(high, p);
  }
  void grow(const Ref& r) {
    low = min(low, Point::of(r.low));
    high = max(high, Point::of(r.high));
  }
  void grow(const Extent& e) {
    low = min(low, e.low);
    high = max(high, e.high);
  }
  Aabb box() const {
    float a[4], b[4];
    low.store(a);
    high.store(b);
    return {{a[0], a[1], a[2]}, {b[0], b[1], b[2]}};
  }
  // Half the surface; 0 for an empty box.
  float half_area() const { return sum_of_products(max(high - low, Point::all(0.0f))); }
};

}  // namespace parhelion
