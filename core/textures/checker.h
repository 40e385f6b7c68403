// A checkerboard: a square of uv is two by two fields.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Checker {
  Vec3 color0, color1;
  float filter;

  static constexpr const char* doc =
      "checkerboard of two by two fields in the unit square of uv, `color0` at (0, 0)";
  static constexpr ParamInfo params[] = {
      {"color0", 3, {0.4f, 0.4f, 0.4f}, 0.0f, 1e12f, "of the field at (0, 0), linear RGB"},
      {"color1", 3, {0.2f, 0.2f, 0.2f}, 0.0f, 1e12f, "of the fields beside it, linear RGB"},
      {"filter",
       1,
       {0.0f},
       0.0f,
       1.0f,
       "`box` averages what a pixel sees, `none` does not",
       "box|none"},
  };
};

// The mean over [x - width / 2, x + width / 2] of the square wave that is 1 on the first half of
// every unit and -1 on the second. Of a small width there is at most one edge in reach; the rest is
// the difference of the wave's integral, a triangle.
PH_INLINE float square_wave(float x, float width) {
  const float f = clamp(x - floor(x), 0.0f, 1.0f);  // NaN, of what is not finite, becomes 1
  const float sign = f <= 0.5f ? 1.0f : -1.0f;
  if (!(width > 0.0f)) return sign;
  if (width < 0.5f) {
    const float within = f <= 0.5f ? f : f - 0.5f;
    return sign * min((0.25f - abs(within - 0.25f)) * (2.0f / width), 1.0f);
  }
  const auto integral = [](float at) { return 0.5f - abs(at - floor(at) - 0.5f); };
  return (integral(f + 0.5f * width) - integral(f - 0.5f * width)) / width;
}

PH_INLINE Texel lookup(const Checker& t, const ImageView*, const TextureRecord&,
                       const TexturePoint& point) {
  const float width = t.filter == 0.0f ? min(point.width, 1e4f) : 0.0f;
  const float both = square_wave(point.uv.x, width) * square_wave(point.uv.y, width);
  return {t.color0 * (0.5f + 0.5f * both) + t.color1 * (0.5f - 0.5f * both), 1.0f};
}

}  // namespace parhelion::PH_ISA
