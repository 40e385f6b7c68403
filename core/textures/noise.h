// Clouds, marble, dirt: gradient noise summed over octaves.
//
// Method: K. Perlin, "Improving noise", SIGGRAPH 2002, with a hash in place of the permutation
// table, so that it does not repeat; octaves too fine for the footprint fade out.
#pragma once
#include "../lookup.h"
#include "../random.h"

namespace parhelion::PH_ISA {

struct Noise {
  Vec3 color0, color1;
  float size, octaves, gain, shape, space, seed;

  static constexpr const char* doc = "random blotches of many sizes, from `color0` to `color1`";
  static constexpr ParamInfo params[] = {
      {"color0", 3, {0.0f, 0.0f, 0.0f}, 0.0f, 1e12f, "where the noise is lowest, linear RGB"},
      {"color1", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "where it is highest, linear RGB"},
      {"size", 1, {1.0f}, 1e-12f, 1e12f, "of the largest blotches, in scene units or in uv"},
      {"octaves", 1, {4.0f}, 1.0f, 16.0f, "sizes of blotches, each half of the one before"},
      {"gain", 1, {0.5f}, 0.0f, 1.0f, "strength of each octave over that of the one before"},
      {"shape",
       1,
       {0.0f},
       0.0f,
       1.0f,
       "`turbulence` adds up the octaves' sizes, which makes veins",
       "fbm|turbulence"},
      {"space", 1, {0.0f}, 0.0f, 1.0f, "`solid` fills space, `uv` lies on the surface", "solid|uv"},
      {"seed", 1, {0.0f}, 0.0f, 65535.0f, "a whole number for another noise"},
  };
};

// The gradient at a corner of the lattice, one of the twelve from a cube's middle to its edges,
// times the way from there.
PH_INLINE float corner_slope(int x, int y, int z, u64 key, Vec3 way) {
  const auto bits = [](int i) { return static_cast<u64>(static_cast<u32>(i) & 0xffffu); };
  const u64 hash = mix(key + (bits(x) | bits(y) << 16 | bits(z) << 32));
  const float a = (hash & 1u) != 0 ? -1.0f : 1.0f, b = (hash & 2u) != 0 ? -1.0f : 1.0f;
  switch ((hash >> 32) % 3u) {
    case 0: return a * way.x + b * way.y;
    case 1: return a * way.y + b * way.z;
    default: return a * way.x + b * way.z;
  }
}

// In [-1, 1], 0 at the corners of the unit lattice. Repeats after 65536.
inline float gradient_noise(Vec3 p, u32 seed) {
  const u64 key = mix(seed + 1);
  // Cells are counted modulo 65536; what is not finite lies in cell 65535 and at its far end.
  const Vec3 low = {floor(p.x), floor(p.y), floor(p.z)};
  const auto cell = [](float n) {
    return static_cast<int>(clamp(n - 65536.0f * floor(n * 0x1p-16f), 0.0f, 65535.0f));
  };
  const int x = cell(low.x), y = cell(low.y), z = cell(low.z);
  const Vec3 f = {min(p.x - low.x, 1.0f), min(p.y - low.y, 1.0f), min(p.z - low.z, 1.0f)};
  const auto fade = [](float t) { return t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f); };
  const auto between = [](float a, float b, float t) { return a + (b - a) * t; };
  const Vec3 w = {fade(f.x), fade(f.y), fade(f.z)};
  float plane[2];
  for (int k = 0; k < 2; ++k) {
    const float dz = f.z - static_cast<float>(k);
    const auto row = [&](int j) {
      const float dy = f.y - static_cast<float>(j);
      return between(corner_slope(x, y + j, z + k, key, {f.x, dy, dz}),
                     corner_slope(x + 1, y + j, z + k, key, {f.x - 1.0f, dy, dz}), w.x);
    };
    plane[k] = between(row(0), row(1), w.y);
  }
  return clamp(between(plane[0], plane[1], w.z), -1.0f, 1.0f);
}

PH_INLINE Texel lookup(const Noise& t, const ImageView*, const TextureRecord&,
                       const TexturePoint& point) {
  const bool solid = t.space == 0.0f;
  const Vec3 from = solid ? point.position : Vec3{point.uv.x, point.uv.y, 0.0f};
  const float width = (solid ? point.solid_width : point.width) / t.size;
  const u32 seed = static_cast<u32>(t.seed) << 8;
  Vec3 p = from * (1.0f / t.size);
  float sum = 0.0f, total = 0.0f, strength = 1.0f, blur = width;
  for (int i = 0; i < static_cast<int>(t.octaves); ++i) {
    // An octave counts in full down to four footprints a blotch and not at all from two on.
    const float share = strength * clamp(2.0f - 4.0f * blur, 0.0f, 1.0f);
    const float value = share > 0.0f ? gradient_noise(p, seed + static_cast<u32>(i)) : 0.0f;
    sum += share * (t.shape == 0.0f ? value : abs(value));
    total += t.shape == 0.0f ? strength * strength : strength;
    strength *= t.gain;
    blur *= 2.0f;
    p *= 2.0f;
  }
  // Octaves are independent: over the root of the sum of squares they keep the contrast of one.
  // Sizes add up to no more than their sum.
  const float share =
      t.shape == 0.0f ? clamp(0.5f + 0.5f * sum / sqrt(total), 0.0f, 1.0f) : sum / total;
  return {t.color0 * (1.0f - share) + t.color1 * share, 1.0f};
}

// A part of the finest blotches, or half the footprint.
PH_INLINE float step(const Noise& t, const ImageView*, const TextureRecord&,
                     const TexturePoint& point, UvScale scale) {
  const bool solid = t.space == 0.0f;
  const float finest = scale_by_power(t.size, 1 - static_cast<int>(t.octaves));
  const float h = max(0.5f * (solid ? point.solid_width : point.width), 0x1p-5f * finest);
  return h / max(solid ? scale.solid : scale.own, 1e-6f * t.size);
}

}  // namespace parhelion::PH_ISA
