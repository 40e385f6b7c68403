// Random numbers as a pure function of (pixel, sample, dimension, seed). No state is carried, so
// any sample can be made again alone, on any machine.
#pragma once
#include "math.h"

namespace parhelion {

enum class SamplerKind : u32 {
#define SAMPLER(name, doc) name,
#include "samplers.def"
#undef SAMPLER
};

// What each random draw of a path is for. A bounce takes the next kDrawsPerBounce dimensions.
enum Draw : u32 {
  kDrawPixel,  // place inside the pixel filter
  kDrawLens,   // place on the lens
  kDrawFirstBounce,
  kDrawChannel = ~0u,  // the colour that a path goes on with, once a prism has split it
};
enum BounceDraw : u32 {
  kDrawLobe,        // which lobe of a material scatters, once a normal is known
  kDrawDirection,   // which lobe scatters, and the direction
  kDrawLight,       // lower bits of what chooses a light
  kDrawLightPoint,  // what chooses it, and places the point on it
  kDrawRoulette,
  kDrawBlend,    // which of two blended materials is there
  kDrawOpacity,  // whether a ray finds a surface or a hole in it
  kDrawsPerBounce,
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// A 64-bit finaliser whose every output bit depends on every input bit.
// Constants: D. Stafford's variant 13 of the MurmurHash3 mixer.
PH_INLINE u64 mix(u64 x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}

PH_INLINE u32 reverse_bits(u32 x) {
  x = compiler::reverse_bytes(x);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
}

// A uniform float in [0, 1) from the upper 24 bits: all multiples of 2^-24 are equally likely.
PH_INLINE float to_unit(u32 x) { return static_cast<float>(x >> 8) * 0x1p-24f; }

// A random nested permutation of the low bits upwards: each bit is flipped by a hash of the lower
// ones only. On bit-reversed fractions that is Owen's scrambling.
// Method: Laine and Karras 2011 and Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4),
// 2020; constants: N. Vegdahl, "Building a Better LK Hash", 2021.
PH_INLINE u32 nested_permutation(u32 x, u32 seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}

// The second dimension of Sobol's sequence for a sample index, as a bit-reversed fraction. Its
// generator matrix is Pascal's triangle modulo 2, a five-fold Kronecker product of [1 1; 0 1], so
// five masked shifts multiply by it.
PH_INLINE u32 sobol_second_reversed(u32 index) {
  index ^= (index & 0xaaaaaaaau) >> 1;
  index ^= (index & 0xccccccccu) >> 2;
  index ^= (index & 0xf0f0f0f0u) >> 4;
  index ^= (index & 0xff00ff00u) >> 8;
  index ^= (index & 0xffff0000u) >> 16;
  return index;
}

// The random numbers of one sample of one pixel.
struct Sampler {
  SamplerKind kind;
  u32 reversed_index;  // the sample's index, bits reversed, which Sobol' alone reads
  u64 key;             // of the pixel and seed; for `independent` also of the sample
};

PH_INLINE u64 dimension_hash(u64 key, u32 dimension) {
  return mix(key + (dimension + 1) * 0x9e3779b97f4a7c15ull);
}

PH_INLINE Vec2 independent_pair(u64 hash) {
  return {to_unit(static_cast<u32>(hash)), to_unit(static_cast<u32>(hash >> 32))};
}
// Every dimension takes the same (0,2)-sequence in another nested order, which keeps its
// stratification over each power of two of samples and makes dimensions independent.
PH_INLINE Vec2 sobol_pair(u32 reversed_index, u64 hash) {
  const u32 low = static_cast<u32>(hash), high = static_cast<u32>(hash >> 32);
  const u32 index = reverse_bits(nested_permutation(reversed_index, low));
  const u32 x = nested_permutation(index, high);
  const u32 y = nested_permutation(sobol_second_reversed(index), high * 0x2c9277b5u + 0x5bd1e995u);
  return {to_unit(reverse_bits(x)), to_unit(reverse_bits(y))};
}

// Two numbers in [0, 1) for one dimension of the sample.
PH_INLINE Vec2 draw2(const Sampler& s, u32 dimension) {
  const u64 hash = dimension_hash(s.key, dimension);
  return s.kind == SamplerKind::independent ? independent_pair(hash)
                                            : sobol_pair(s.reversed_index, hash);
}

// One number in [0, 1).
PH_INLINE float draw1(const Sampler& s, u32 dimension) { return draw2(s, dimension).x; }

// The samplers of a batch, all of one kind, each with the dimension that its next numbers begin at.
template <u32 kCount>
struct SamplerBatch {
  SamplerKind kind;
  u64 key[kCount];
  u32 reversed_index[kCount], dimension[kCount];

  PH_INLINE Sampler at(u32 i) const { return {kind, reversed_index[i], key[i]}; }
};

template <u32 kCount>
PH_INLINE SamplerBatch<kCount> make_samplers(SamplerKind kind, const u32 (&x)[kCount],
                                             const u32 (&y)[kCount], const u32 (&sample)[kCount],
                                             u64 seed) {
  SamplerBatch<kCount> s;
  s.kind = kind;
  for (u32 i = 0; i < kCount; ++i) {
    const u64 pixel = static_cast<u64>(y[i]) << 32 | x[i];
    s.key[i] = mix(pixel + mix(seed + 0x9e3779b97f4a7c15ull));
    s.reversed_index[i] = reverse_bits(sample[i]);
    s.dimension[i] = 0;
  }
  if (kind == SamplerKind::independent) {
    for (u32 i = 0; i < kCount; ++i) s.key[i] = mix(s.key[i] + sample[i]);
  }
  return s;
}
PH_INLINE Sampler make_sampler(SamplerKind kind, u32 x, u32 y, u32 sample, u64 seed) {
  return make_samplers<1>(kind, {x}, {y}, {sample}, seed).at(0);
}

// draw2 for all of a batch, in a loop that compilers turn into vectors.
template <u32 kCount>
PH_INLINE void draw2(const SamplerBatch<kCount>& s, u32 dimension, float (&x)[kCount],
                     float (&y)[kCount]) {
  if (s.kind == SamplerKind::independent) {
    for (u32 i = 0; i < kCount; ++i) {
      const Vec2 u = independent_pair(dimension_hash(s.key[i], s.dimension[i] + dimension));
      x[i] = u.x, y[i] = u.y;
    }
  } else {
    for (u32 i = 0; i < kCount; ++i) {
      const u64 hash = dimension_hash(s.key[i], s.dimension[i] + dimension);
      const Vec2 u = sobol_pair(s.reversed_index[i], hash);
      x[i] = u.x, y[i] = u.y;
    }
  }
}

// draw1 for all of them.
template <u32 kCount>
PH_INLINE void draw1(const SamplerBatch<kCount>& s, u32 dimension, float (&x)[kCount]) {
  if (s.kind == SamplerKind::independent) {
    for (u32 i = 0; i < kCount; ++i) {
      x[i] = independent_pair(dimension_hash(s.key[i], s.dimension[i] + dimension)).x;
    }
  } else {
    for (u32 i = 0; i < kCount; ++i) {
      const u64 hash = dimension_hash(s.key[i], s.dimension[i] + dimension);
      x[i] = sobol_pair(s.reversed_index[i], hash).x;
    }
  }
}

}  // namespace parhelion::PH_ISA
