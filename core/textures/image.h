// A picture on the surface.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Image {
  float filter, wrap_u, wrap_v;

  static constexpr bool has_image = true;
  static constexpr const char* doc = "a picture, its bottom left corner at uv (0, 0)";
  static constexpr ParamInfo params[] = {
      {"filter",
       1,
       {0.0f},
       0.0f,
       2.0f,
       "between texels: `mip` averages what a pixel sees, `bilinear` and `nearest` do not",
       "mip|bilinear|nearest"},
      {"wrap_u",
       1,
       {0.0f},
       0.0f,
       3.0f,
       "what is to the left and right of the picture",
       "repeat|mirror|clamp|zero"},
      {"wrap_v",
       1,
       {0.0f},
       0.0f,
       3.0f,
       "what is above and below the picture",
       "repeat|mirror|clamp|zero"},
  };
};

PH_INLINE bool is_nearest(const Image& t) { return t.filter == 2.0f; }
// Over which texels are averaged, where a pixel sees `width` of uv.
PH_INLINE float filtered_width(const Image& t, float width) {
  return t.filter == 0.0f ? width : 0.0f;
}

PH_INLINE Texel lookup(const Image& t, const ImageView* images, const TextureRecord& record,
                       const TexturePoint& point) {
  const ImageView& image = images[record.image];
  const Wrap wrap_u = static_cast<Wrap>(t.wrap_u), wrap_v = static_cast<Wrap>(t.wrap_v);
  if (is_nearest(t)) return nearest(image, 0, point.uv, wrap_u, wrap_v);
  return trilinear(image, point.uv, filtered_width(t, point.width), wrap_u, wrap_v);
}

// A part of a texel: the differences are then the slopes of the interpolation itself.
PH_INLINE float step(const Image& t, const ImageView* images, const TextureRecord& record,
                     const TexturePoint& point, UvScale scale) {
  const ImageView& image = images[record.image];
  const u32 side = image.width > image.height ? image.width : image.height;
  const float texel = 1.0f / static_cast<float>(side);
  const float least = (is_nearest(t) ? 0.5f : 0.125f) * texel;
  return max(0.5f * filtered_width(t, point.width), least) / max(scale.own, 1e-6f);
}

}  // namespace parhelion::PH_ISA
