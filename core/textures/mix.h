// One colour in places of another, or some of both.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Mix {
  Vec3 color0, color1;
  float weight;

  static constexpr const char* doc =
      "`color0` and `color1` in the shares 1 - `weight` and `weight`";
  static constexpr ParamInfo params[] = {
      {"color0", 3, {0.0f, 0.0f, 0.0f}, 0.0f, 1e12f, "where the weight is 0, linear RGB"},
      {"color1", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "where it is 1, linear RGB"},
      {"weight", 1, {0.5f}, 0.0f, 1.0f, "share of `color1`"},
  };
};

PH_INLINE Texel lookup(const Mix& t, const ImageView*, const TextureRecord&, const TexturePoint&) {
  return {t.color0 * (1.0f - t.weight) + t.color1 * t.weight, 1.0f};
}

}  // namespace parhelion::PH_ISA
