// Pixel filters. A sample is placed in its pixel with the filter's own density, so it counts 1 for
// that pixel and nothing for any other: no weights, no splats, no order effects.
#pragma once
#include "math.h"

namespace parhelion {

enum class FilterKind : u32 {
#define FILTER(name, label, radius, doc) name,
#include "filters.def"
#undef FILTER
};

// Offsets from -radius to 0 at equal steps of the fourth root of the filter's cumulative
// distribution along one axis: fine steps where the filter fades out.
inline constexpr int kFilterSteps = 1024;
struct FilterTable {
  float offset[kFilterSteps + 1];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// exp(-x) for x in [0, 32], in double and without libm.
inline double exp_minus(double x) {
  const double y = x * (1.0 / 1024.0);
  double e = 1.0 - y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0))));
  for (int i = 0; i < 10; ++i) e *= e;
  return e;
}

// The value of a filter at offset x, for its given radius.
inline double box(double, double) { return 1.0; }
inline double tent(double x, double radius) { return 1.0 - x / radius; }
inline double gaussian(double x, double radius) {
  constexpr double alpha = 2.0;  // exp(-2 x^2): a standard deviation of half a pixel
  return exp_minus(alpha * x * x) - exp_minus(alpha * radius * radius);
}
// F. J. Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66(1), 1978: the
// four-term window of minimum side lobes.
inline double blackman_harris(double x, double radius) {
  const double c = cos_pi(x / radius), c2 = 2.0 * c * c - 1.0, c3 = (2.0 * c2 - 1.0) * c;
  return 0.35875 + 0.48829 * c + 0.14128 * c2 + 0.01168 * c3;
}

inline double filter_value(FilterKind kind, double x, double radius) {
  const double size = x < 0.0 ? -x : x;
  if (size > radius) return 0.0;
  switch (kind) {
#define FILTER(name, label, radius_, doc) \
  case FilterKind::name: return name(size, radius);
#include "filters.def"
#undef FILTER
  }
  return 0.0;
}

// Where a number lies in the table: after offset i by a share of a step.
struct FilterStep {
  int i;
  float share;
};

PH_INLINE FilterStep filter_step(float u) {
  const float side = u < 0.5f ? 2.0f * u : 2.0f - 2.0f * u;
  const float x = sqrt(sqrt(side)) * static_cast<float>(kFilterSteps);
  const int whole = static_cast<int>(x), i = whole < kFilterSteps ? whole : kFilterSteps - 1;
  return {i, x - static_cast<float>(i)};
}

// Offsets from pixels' centres, in pixels; the filter's other half mirrors the table's. Loops that
// compilers turn into vectors, around the one that looks up.
template <u32 kCount>
PH_APART inline void filter_offsets(const FilterTable& __restrict table,
                                    const float (&__restrict u)[kCount],
                                    float (&__restrict offset)[kCount]) {
  int index[kCount];
  float share[kCount], low[kCount], high[kCount];
  for (u32 k = 0; k < kCount; ++k) {
    const FilterStep at = filter_step(u[k]);
    index[k] = at.i, share[k] = at.share;
  }
  for (u32 k = 0; k < kCount; ++k) {
    low[k] = table.offset[index[k]], high[k] = table.offset[index[k] + 1];
  }
  for (u32 k = 0; k < kCount; ++k) {
    const float size = low[k] + share[k] * (high[k] - low[k]);
    offset[k] = u[k] < 0.5f ? size : -size;
  }
}

}  // namespace parhelion::PH_ISA
