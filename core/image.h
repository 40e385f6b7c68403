// Images as the kernels see them: a pyramid of levels, each half the size of the one before, and
// the ways to look them up.
//
// Row 0 of an image is its top, where v = 1; the first column is at u = 0. Texel centres lie at
// half whole numbers, as in OpenGL: texel (x, y) of a w by h image is centred on u = (x + 1/2) / w,
// v = 1 - (y + 1/2) / h.
#pragma once
#include "simd.h"
#include "special.h"

namespace parhelion {

enum class ImageFormat : u32 {
  srgb8,    // bytes encoded as in IEC 61966-2-1; an alpha channel is not encoded
  linear8,  // bytes, 255 being 1
  float32,
};

// Halvings of the longest side that is allowed, 65536, and the image itself.
inline constexpr u32 kMaxImageSide = 1u << 16, kMaxImageLevels = 17;

struct ImageView {
  const void* texels;  // all levels, by rows, channels side by side
  u32 width, height;   // of level 0; those of level l are max(1, width >> l) and so on
  u32 levels;
  ImageFormat format;
  u32 channels;                // 1, 3 or 4: grey, RGB, RGB and alpha
  u32 first[kMaxImageLevels];  // the first texel of each level
};

// What a texture or image has at a place: linear RGB, and alpha, which is 1 where there is none.
struct Texel {
  Vec3 rgb;
  float a;
};

// What lies beyond the borders of an image.
enum class Wrap : u32 { repeat, mirror, clamp, zero };

}  // namespace parhelion

namespace parhelion::PH_ISA {

// The fifth root of x in (0, 1] by Newton's method, from above.
constexpr double fifth_root(double x) {
  double r = 1.0;
  for (int i = 0; i < 60; ++i) r -= (r - x / (r * r * r * r)) * 0.2;
  return r;
}

// Values of the 256 bytes, rounded once: plain ones, and linear ones of sRGB's codes
// (IEC 61966-2-1).
struct ByteTables {
  float plain[256], srgb[256];

  constexpr ByteTables() : plain(), srgb() {
    for (int i = 0; i < 256; ++i) {
      const double code = i / 255.0, x = (code + 0.055) / 1.055;
      const double root = fifth_root(x);  // x^2.4 = x^2 (x^(1/5))^2
      plain[i] = static_cast<float>(i) / 255.0f;
      srgb[i] = static_cast<float>(code <= 0.04045 ? code / 12.92 : x * x * root * root);
    }
  }
};
PH_TABLE ByteTables kBytes;

PH_INLINE Texel operator+(const Texel& a, const Texel& b) { return {a.rgb + b.rgb, a.a + b.a}; }
PH_INLINE Texel operator*(const Texel& a, float s) { return {a.rgb * s, a.a * s}; }

PH_INLINE Texel to_texel(Quad q) {
  float c[4];
  store(c, q);
  return {{c[0], c[1], c[2]}, c[3]};
}
// In a form that gives a itself where a and b are the same.
PH_INLINE Quad mix(Quad a, Quad b, float t) { return a + (b - a) * t; }

PH_INLINE u32 level_side(u32 side, u32 level) {
  const u32 halved = side >> level;
  return halved > 0 ? halved : 1;
}

// Calls f with what reads a texel of an image, red, green, blue and alpha, by its number among
// those of all levels: one for each format, so that many are read without asking for it each time.
template <class F>
PH_INLINE auto with_texels(const ImageView& image, F&& f) {
  if (image.format == ImageFormat::float32) {
    const float* c = static_cast<const float*>(image.texels);
    if (image.channels == 1) return f([c](u64 i) { return quad(c[i], c[i], c[i], 1.0f); });
    if (image.channels == 3) {
      return f([c](u64 i) { return quad(c[3 * i], c[3 * i + 1], c[3 * i + 2], 1.0f); });
    }
    return f([c](u64 i) { return quad(c[4 * i], c[4 * i + 1], c[4 * i + 2], c[4 * i + 3]); });
  }
  const u8* c = static_cast<const u8*>(image.texels);
  const float* value = image.format == ImageFormat::srgb8 ? kBytes.srgb : kBytes.plain;
  if (image.channels == 1) {
    return f([c, value](u64 i) {
      const float grey = value[c[i]];
      return quad(grey, grey, grey, 1.0f);
    });
  }
  if (image.channels == 3) {
    return f([c, value](u64 i) {
      return quad(value[c[3 * i]], value[c[3 * i + 1]], value[c[3 * i + 2]], 1.0f);
    });
  }
  return f([c, value](u64 i) {
    return quad(value[c[4 * i]], value[c[4 * i + 1]], value[c[4 * i + 2]],
                kBytes.plain[c[4 * i + 3]]);
  });
}

// The number of a texel of a level, for a place inside it.
PH_INLINE u64 texel_number(const ImageView& image, u32 level, u32 x, u32 y) {
  return image.first[level] + static_cast<u64>(y) * level_side(image.width, level) + x;
}

PH_INLINE void prefetch(const ImageView& image, u32 level, u32 x, u32 y) {
  const u64 size = (image.format == ImageFormat::float32 ? sizeof(float) : 1) * image.channels;
  compiler::prefetch(static_cast<const u8*>(image.texels) +
                     texel_number(image, level, x, y) * size);
}

PH_INLINE Texel fetch(const ImageView& image, u32 level, u32 x, u32 y) {
  return with_texels(
      image, [&](auto&& texel) { return to_texel(texel(texel_number(image, level, x, y))); });
}

// What follows, up to texels_around, has no branches: loops over many lookups become vectors.

// A coordinate brought near [0, 1], where `wrap_texel` finishes the work on whole texels: there is
// no number that does not fit an int. What is not finite ends up at a border.
PH_INLINE float wrap_coordinate(float x, Wrap wrap) {
  const float period = wrap == Wrap::mirror ? 2.0f : 1.0f;
  const float repeated = period * fraction((wrap == Wrap::mirror ? 0.5f : 1.0f) * x);
  const float bounded = clamp(x, -1.0f, 2.0f);
  const bool ends = (wrap == Wrap::clamp) | (wrap == Wrap::zero);
  return ends ? bounded : repeated;
}

// The index in [0, n) of a texel from such a coordinate or its neighbour; -1 where there is none.
PH_INLINE int wrap_texel(int i, int n, Wrap wrap) {
  const int around = i + (i < 0 ? n : 0) - (i >= n ? n : 0);
  const int far = wrap == Wrap::mirror ? 2 * n - 1 - i : n - 1;
  const int least = i < far ? i : far, edge = least > 0 ? least : 0;
  const int none = wrap == Wrap::zero && edge != i ? -1 : 0;
  return wrap == Wrap::repeat ? around : edge | none;
}

// The two texels of n between which a coordinate lies.
struct TexelPair {
  int first, second;
  float share;  // of the second
};
PH_INLINE TexelPair texels_around(float x, int n, Wrap wrap) {
  const float at = wrap_coordinate(x, wrap) * static_cast<float>(n) - 0.5f;
  const float first = floor_within(at);
  const int i = static_cast<int>(first);
  return {wrap_texel(i, n, wrap), wrap_texel(i + 1, n, wrap), at - first};
}

inline Texel nearest(const ImageView& image, u32 level, Vec2 uv, Wrap wrap_u, Wrap wrap_v) {
  const u32 w = level_side(image.width, level), h = level_side(image.height, level);
  const float x = wrap_coordinate(uv.x, wrap_u) * static_cast<float>(w);
  const float y = wrap_coordinate(1.0f - uv.y, wrap_v) * static_cast<float>(h);
  const int column = wrap_texel(static_cast<int>(floor_within(x)), static_cast<int>(w), wrap_u);
  const int row = wrap_texel(static_cast<int>(floor_within(y)), static_cast<int>(h), wrap_v);
  if (column < 0 || row < 0) return {{0, 0, 0}, 0};
  return fetch(image, level, static_cast<u32>(column), static_cast<u32>(row));
}

inline Quad bilinear_channels(const ImageView& image, u32 level, Vec2 uv, Wrap wrap_u,
                              Wrap wrap_v) {
  const u32 w = level_side(image.width, level), h = level_side(image.height, level);
  const TexelPair x = texels_around(uv.x, static_cast<int>(w), wrap_u);
  const TexelPair y = texels_around(1.0f - uv.y, static_cast<int>(h), wrap_v);
  return with_texels(image, [&](auto&& texel) {
    const auto at = [&](int column, int row) {
      if (column < 0 || row < 0) return quad(0.0f, 0.0f, 0.0f, 0.0f);
      return texel(texel_number(image, level, static_cast<u32>(column), static_cast<u32>(row)));
    };
    const Quad upper = mix(at(x.first, y.first), at(x.second, y.first), x.share);
    const Quad lower = mix(at(x.first, y.second), at(x.second, y.second), x.share);
    return mix(upper, lower, y.share);
  });
}

PH_INLINE Texel bilinear(const ImageView& image, u32 level, Vec2 uv, Wrap wrap_u, Wrap wrap_v) {
  return to_texel(bilinear_channels(image, level, uv, wrap_u, wrap_v));
}

// Between the two levels whose texels are next in size to a footprint `width` wide in uv.
// Method: L. Williams, "Pyramidal parametrics", SIGGRAPH 1983; for images that are not square, of
// the footprint's two extents in texels the longer, as in OpenGL, so nothing is aliased.
inline Texel trilinear(const ImageView& image, Vec2 uv, float width, Wrap wrap_u, Wrap wrap_v) {
  const u32 side = image.width > image.height ? image.width : image.height;
  const float texels = width * static_cast<float>(side);
  if (!(texels > 1.0f)) return bilinear(image, 0, uv, wrap_u, wrap_v);
  const float place = min(log2(texels), static_cast<float>(image.levels - 1));
  const u32 level = static_cast<u32>(place);
  const Quad fine = bilinear_channels(image, level, uv, wrap_u, wrap_v);
  const float share = place - static_cast<float>(level);
  if (!(share > 0.0f)) return to_texel(fine);
  return to_texel(mix(fine, bilinear_channels(image, level + 1, uv, wrap_u, wrap_v), share));
}

// The largest values of each channel, for the power of lights: a walk over all texels.
inline Vec3 brightest(const ImageView& image) {
  Vec3 most = {0, 0, 0};
  for (u32 y = 0; y < image.height; ++y) {
    for (u32 x = 0; x < image.width; ++x) {
      const Vec3 c = fetch(image, 0, x, y).rgb;
      most = {max(most.x, c.x), max(most.y, c.y), max(most.z, c.z)};
    }
  }
  return most;
}

}  // namespace parhelion::PH_ISA
