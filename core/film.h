// The sum of a pixel's samples, exact.
//
// A sample is added as an integer count of 2^-52, in two words, so addition is associative: any
// split of the samples over threads, machines, passes or restarts gives the same bits.
#pragma once
#include "math.h"

namespace parhelion {

// high counts 2^-12 and low counts 2^-52, below 2^40 a sample: 2^23 samples fit before low must be
// carried over. Radiance beyond kLargest is cut to it.
struct FilmSum {
  i64 high, low;
};

struct FilmPixel {
  FilmSum rgb[3];
  u32 count;
  u32 bad;  // samples that were not finite, left out of the sum and counted as black
};

// How many of a pixel's samples saw which shape, or material; a slot of count 0 is free. Pictures
// keep the six largest (kMatteRanks): two slots more, as which six they are shows only in the end.
inline constexpr u32 kTallySlots = 8;
struct Tally {
  u32 index[kTallySlots], count[kTallySlots];
};

// The sums of a pixel's features, in the order of Features in path.h; those of place and shape over
// the samples that hit something.
inline constexpr u32 kPlaceFloats = 12, kLightFloats = 9;
struct FeaturePixel {
  FilmSum place[kPlaceFloats];  // depth, position, normal, shading normal, uv
  FilmSum light[kLightFloats];  // albedo, emission, direct light
  u32 hits, count;
  u32 shape, material;  // of the first sample; kNone if it hit nothing
  Tally shapes, materials;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

inline constexpr float kLargest = 0x1p40f;

PH_INLINE FilmSum count(float value) {
  const double scaled = static_cast<double>(clamp(value, -kLargest, kLargest)) * 0x1p12;
  const i64 high = static_cast<i64>(scaled);
  return {high, static_cast<i64>((scaled - static_cast<double>(high)) * 0x1p40)};
}

PH_INLINE void add(FilmSum& sum, FilmSum counted) {
  sum.high += counted.high;
  sum.low += counted.low;
}
PH_INLINE void add(FilmSum& sum, float value) { add(sum, count(value)); }

PH_INLINE void add(FilmPixel& pixel, Vec3 radiance) {
  ++pixel.count;
  if (!finite(radiance)) {
    ++pixel.bad;
    return;
  }
  add(pixel.rgb[0], radiance.x);
  add(pixel.rgb[1], radiance.y);
  add(pixel.rgb[2], radiance.z);
}

// Counts many samples, of which those that are not finite count 0 and are bad: a loop that
// compilers turn into vectors. rgb, high, low: by colour and sample.
template <u32 kCount>
PH_APART inline void count_all(const float (&__restrict rgb)[3][kCount],
                               u32 (&__restrict bad)[kCount], i64 (&__restrict high)[3][kCount],
                               i64 (&__restrict low)[3][kCount]) {
  for (u32 i = 0; i < kCount; ++i) {
    const Vec3 light = {rgb[0][i], rgb[1][i], rgb[2][i]};
    const bool good = finite(light);
    const Vec3 c = select(good, light, Vec3{0, 0, 0});
    const FilmSum red = count(c.x), green = count(c.y), blue = count(c.z);
    bad[i] = good ? 0 : 1;
    high[0][i] = red.high, low[0][i] = red.low;
    high[1][i] = green.high, low[1][i] = green.low;
    high[2][i] = blue.high, low[2][i] = blue.low;
  }
}

// Adds many samples, sample i to the pixel row[at[i]]; the first n count.
template <u32 kCount>
PH_INLINE void add(FilmPixel* row, const u32 (&at)[kCount], const float (&rgb)[3][kCount], u32 n) {
  i64 high[3][kCount], low[3][kCount];
  u32 bad[kCount];
  count_all(rgb, bad, high, low);
  for (u32 i = 0; i < n; ++i) {
    FilmPixel& pixel = row[at[i]];
    ++pixel.count;
    pixel.bad += bad[i];
    for (u32 k = 0; k < 3; ++k) add(pixel.rgb[k], {high[k][i], low[k][i]});
  }
}

// Counts one sample. What finds no slot left is not counted: the slots are those of what was seen
// first, which is the same for any split of samples that come in the order of their numbers.
PH_INLINE void add(Tally& tally, u32 index) {
  for (u32 i = 0; i < kTallySlots; ++i) {
    if (tally.count[i] == 0) tally.index[i] = index;
    if (tally.index[i] == index) {
      ++tally.count[i];
      return;
    }
  }
}

// Brings `low` back under 2^40, so that equal sums are equal words.
PH_INLINE void carry(FilmSum& sum) {
  sum.high += sum.low >> 40;
  sum.low &= (1ll << 40) - 1;
}
PH_INLINE void carry(FilmPixel& pixel) {
  for (FilmSum& sum : pixel.rgb) carry(sum);
}
PH_INLINE void carry(FeaturePixel& pixel) {
  for (FilmSum& sum : pixel.place) carry(sum);
  for (FilmSum& sum : pixel.light) carry(sum);
}

PH_INLINE float mean(const FilmSum& sum, u32 count) {
  const double total =
      static_cast<double>(sum.high) * 0x1p-12 + static_cast<double>(sum.low) * 0x1p-52;
  return count == 0 ? 0.0f : static_cast<float>(total / count);
}

}  // namespace parhelion::PH_ISA
