// Sixteen lanes of float, whatever the processor: one AVX-512 register, two of AVX2, four of SSE or
// of the compiler's own vectors, or sixteen plain floats. The width seen by the algorithms is
// always 16, so every instruction set walks the same tree through the same arithmetic to the same
// bits. And four, for colours and rows of tables.
#pragma once
#include "math.h"

#if defined(__AVX512F__) || defined(__AVX2__) || defined(__SSE4_2__)
#include <immintrin.h>
#endif

namespace parhelion::PH_ISA {

inline constexpr int kLanes = 16;

// --- One native register: Vf floats, Vm the result of a comparison ------------------------------
#if defined(__AVX512F__)
using Vf = __m512;
using Vm = __mmask16;
inline constexpr int kNative = 16;
PH_INLINE Vf v_load(const float* p) { return _mm512_loadu_ps(p); }
PH_INLINE void v_store(float* p, Vf a) { _mm512_storeu_ps(p, a); }
PH_INLINE Vf v_set(float a) { return _mm512_set1_ps(a); }
PH_INLINE Vf v_min(Vf a, Vf b) { return _mm512_min_ps(a, b); }
PH_INLINE Vf v_max(Vf a, Vf b) { return _mm512_max_ps(a, b); }
PH_INLINE Vf v_sqrt(Vf a) { return _mm512_sqrt_ps(a); }
PH_INLINE Vm v_le(Vf a, Vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
PH_INLINE Vm v_lt(Vf a, Vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
PH_INLINE Vm v_and(Vm a, Vm b) { return static_cast<Vm>(a & b); }
PH_INLINE Vm v_or(Vm a, Vm b) { return static_cast<Vm>(a | b); }
PH_INLINE Vf v_select(Vm m, Vf a, Vf b) { return _mm512_mask_blend_ps(m, b, a); }
PH_INLINE u32 v_bits(Vm m) { return m; }
PH_INLINE u32 v_zeros(const u32* p, u32 flipped, u32 some) {
  const __m512i n =
      _mm512_xor_si512(_mm512_loadu_si512(p), _mm512_set1_epi32(static_cast<int>(flipped)));
  return _mm512_testn_epi32_mask(n, _mm512_set1_epi32(static_cast<int>(some)));
}
#elif defined(__AVX2__)
using Vf = __m256;
using Vm = __m256;
inline constexpr int kNative = 8;
PH_INLINE Vf v_load(const float* p) { return _mm256_loadu_ps(p); }
PH_INLINE void v_store(float* p, Vf a) { _mm256_storeu_ps(p, a); }
PH_INLINE Vf v_set(float a) { return _mm256_set1_ps(a); }
PH_INLINE Vf v_min(Vf a, Vf b) { return _mm256_min_ps(a, b); }
PH_INLINE Vf v_max(Vf a, Vf b) { return _mm256_max_ps(a, b); }
PH_INLINE Vf v_sqrt(Vf a) { return _mm256_sqrt_ps(a); }
PH_INLINE Vm v_le(Vf a, Vf b) { return _mm256_cmp_ps(a, b, _CMP_LE_OQ); }
PH_INLINE Vm v_lt(Vf a, Vf b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
PH_INLINE Vm v_and(Vm a, Vm b) { return _mm256_and_ps(a, b); }
PH_INLINE Vm v_or(Vm a, Vm b) { return _mm256_or_ps(a, b); }
PH_INLINE Vf v_select(Vm m, Vf a, Vf b) { return _mm256_blendv_ps(b, a, m); }
PH_INLINE u32 v_bits(Vm m) { return static_cast<u32>(_mm256_movemask_ps(m)); }
using Vi = __m256i;
PH_INLINE Vi v_min(Vi a, Vi b) { return _mm256_min_epi32(a, b); }
PH_INLINE Vm v_lt(Vi a, Vi b) { return _mm256_castsi256_ps(_mm256_cmpgt_epi32(b, a)); }
PH_INLINE Vi v_least(Vi a) {
  a = _mm256_min_epi32(a, _mm256_permute2x128_si256(a, a, 1));  // halves exchanged
  a = _mm256_min_epi32(a, _mm256_shuffle_epi32(a, 0x4e));       // quarters
  return _mm256_min_epi32(a, _mm256_shuffle_epi32(a, 0xb1));    // neighbours
}
PH_INLINE int v_first(Vi a) { return _mm256_cvtsi256_si32(a); }
PH_INLINE u32 v_zeros(const u32* p, u32 flipped, u32 some) {
  __m256i n = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
  n = _mm256_xor_si256(n, _mm256_set1_epi32(static_cast<int>(flipped)));
  n = _mm256_and_si256(n, _mm256_set1_epi32(static_cast<int>(some)));
  return v_bits(_mm256_castsi256_ps(_mm256_cmpeq_epi32(n, _mm256_setzero_si256())));
}
#elif defined(__SSE4_2__)
using Vf = __m128;
using Vm = __m128;
inline constexpr int kNative = 4;
PH_INLINE Vf v_load(const float* p) { return _mm_loadu_ps(p); }
PH_INLINE void v_store(float* p, Vf a) { _mm_storeu_ps(p, a); }
PH_INLINE Vf v_set(float a) { return _mm_set1_ps(a); }
PH_INLINE Vf v_min(Vf a, Vf b) { return _mm_min_ps(a, b); }
PH_INLINE Vf v_max(Vf a, Vf b) { return _mm_max_ps(a, b); }
PH_INLINE Vf v_sqrt(Vf a) { return _mm_sqrt_ps(a); }
PH_INLINE Vm v_le(Vf a, Vf b) { return _mm_cmple_ps(a, b); }
PH_INLINE Vm v_lt(Vf a, Vf b) { return _mm_cmplt_ps(a, b); }
PH_INLINE Vm v_and(Vm a, Vm b) { return _mm_and_ps(a, b); }
PH_INLINE Vm v_or(Vm a, Vm b) { return _mm_or_ps(a, b); }
PH_INLINE Vf v_select(Vm m, Vf a, Vf b) { return _mm_blendv_ps(b, a, m); }
PH_INLINE u32 v_bits(Vm m) { return static_cast<u32>(_mm_movemask_ps(m)); }
using Vi = __m128i;
PH_INLINE Vi v_min(Vi a, Vi b) { return _mm_min_epi32(a, b); }
PH_INLINE Vm v_lt(Vi a, Vi b) { return _mm_castsi128_ps(_mm_cmplt_epi32(a, b)); }
PH_INLINE Vi v_least(Vi a) {
  a = _mm_min_epi32(a, _mm_shuffle_epi32(a, 0x4e));     // halves exchanged
  return _mm_min_epi32(a, _mm_shuffle_epi32(a, 0xb1));  // neighbours
}
PH_INLINE int v_first(Vi a) { return _mm_cvtsi128_si32(a); }
PH_INLINE u32 v_zeros(const u32* p, u32 flipped, u32 some) {
  __m128i n = _mm_loadu_si128(reinterpret_cast<const __m128i*>(p));
  n = _mm_xor_si128(n, _mm_set1_epi32(static_cast<int>(flipped)));
  n = _mm_and_si128(n, _mm_set1_epi32(static_cast<int>(some)));
  return v_bits(_mm_castsi128_ps(_mm_cmpeq_epi32(n, _mm_setzero_si128())));
}
#elif !defined(__CUDACC__)
// The compiler's own vectors: SSE2, NEON, or whatever else a processor has.
typedef float Vf __attribute__((vector_size(16)));
typedef int Vm __attribute__((vector_size(16)));
inline constexpr int kNative = 4;
PH_INLINE Vf v_load(const float* p) {
  Vf a;
  compiler::copy(&a, p, sizeof a);
  return a;
}
PH_INLINE void v_store(float* p, Vf a) { compiler::copy(p, &a, sizeof a); }
PH_INLINE Vf v_set(float a) { return Vf{a, a, a, a}; }
PH_INLINE Vf v_min(Vf a, Vf b) { return a < b ? a : b; }
PH_INLINE Vf v_max(Vf a, Vf b) { return a > b ? a : b; }
PH_INLINE Vf v_sqrt(Vf a) { return Vf{sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])}; }
PH_INLINE Vm v_le(Vf a, Vf b) { return a <= b; }
PH_INLINE Vm v_lt(Vf a, Vf b) { return a < b; }
PH_INLINE Vm v_and(Vm a, Vm b) { return a & b; }
PH_INLINE Vm v_or(Vm a, Vm b) { return a | b; }
PH_INLINE Vf v_select(Vm m, Vf a, Vf b) { return m ? a : b; }
PH_INLINE u32 v_bits(Vm m) {
  m &= Vm{1, 2, 4, 8};
  return static_cast<u32>(m[0] | m[1] | m[2] | m[3]);
}
using Vi = Vm;
PH_INLINE Vi v_min(Vi a, Vi b) { return a < b ? a : b; }
PH_INLINE Vm v_lt(Vi a, Vi b) { return a < b; }
PH_INLINE Vi v_least(Vi a) {
  a = v_min(a, Vi{a[2], a[3], a[0], a[1]});
  return v_min(a, Vi{a[1], a[0], a[3], a[2]});
}
PH_INLINE int v_first(Vi a) { return a[0]; }
PH_INLINE u32 v_zeros(const u32* p, u32 flipped, u32 some) {
  u32 r = 0;
  for (u32 k = 0; k < 4; ++k) r |= ((p[k] ^ flipped) & some) == 0 ? 1u << k : 0u;
  return r;
}
#else
using Vf = float;
using Vm = bool;
inline constexpr int kNative = 1;
PH_INLINE Vf v_load(const float* p) { return *p; }
PH_INLINE void v_store(float* p, Vf a) { *p = a; }
PH_INLINE Vf v_set(float a) { return a; }
PH_INLINE Vf v_min(Vf a, Vf b) { return a < b ? a : b; }
PH_INLINE Vf v_max(Vf a, Vf b) { return a > b ? a : b; }
PH_INLINE Vf v_sqrt(Vf a) { return sqrt(a); }
PH_INLINE Vm v_le(Vf a, Vf b) { return a <= b; }
PH_INLINE Vm v_lt(Vf a, Vf b) { return a < b; }
PH_INLINE Vm v_and(Vm a, Vm b) { return a && b; }
PH_INLINE Vm v_or(Vm a, Vm b) { return a || b; }
PH_INLINE Vf v_select(Vm m, Vf a, Vf b) { return m ? a : b; }
PH_INLINE u32 v_bits(Vm m) { return m ? 1u : 0u; }
using Vi = int;
PH_INLINE Vi v_min(Vi a, Vi b) { return a < b ? a : b; }
PH_INLINE Vm v_lt(Vi a, Vi b) { return a < b; }
PH_INLINE Vi v_least(Vi a) { return a; }
PH_INLINE int v_first(Vi a) { return a; }
PH_INLINE u32 v_zeros(const u32* p, u32 flipped, u32 some) {
  return ((*p ^ flipped) & some) == 0 ? 1u : 0u;
}
#endif

// --- Four floats, from floats or from whole numbers ---------------------------------------------
#if defined(__SSE4_2__)
struct Quad {
  __m128 v;
};
PH_INLINE Quad quad(float a, float b, float c, float d) { return {_mm_setr_ps(a, b, c, d)}; }
PH_INLINE Quad load_quad(const u16* p) {
  const __m128i four = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(p));
  return {_mm_cvtepi32_ps(_mm_cvtepu16_epi32(four))};
}
PH_INLINE Quad load_quad(const short* p) {
  const __m128i four = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(p));
  return {_mm_cvtepi32_ps(_mm_cvtepi16_epi32(four))};
}
PH_INLINE Quad load_quad(const float* p) { return {_mm_loadu_ps(p)}; }
PH_INLINE void store(float (&to)[4], Quad a) { _mm_storeu_ps(to, a.v); }
PH_INLINE Quad min(Quad a, Quad b) { return {_mm_min_ps(a.v, b.v)}; }
PH_INLINE Quad max(Quad a, Quad b) { return {_mm_max_ps(a.v, b.v)}; }
PH_INLINE void transpose(Quad& a, Quad& b, Quad& c, Quad& d) {
  _MM_TRANSPOSE4_PS(a.v, b.v, c.v, d.v);
}
PH_INLINE Quad operator+(Quad a, Quad b) { return {a.v + b.v}; }
PH_INLINE Quad operator-(Quad a, Quad b) { return {a.v - b.v}; }
PH_INLINE Quad operator*(Quad a, float s) { return {a.v * _mm_set1_ps(s)}; }
#else
struct Quad {
  float v[4];
};
PH_INLINE Quad quad(float a, float b, float c, float d) { return {{a, b, c, d}}; }
template <class Whole>
PH_INLINE Quad load_quad(const Whole* p) {
  return {{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2]),
           static_cast<float>(p[3])}};
}
PH_INLINE void store(float (&to)[4], Quad a) {
  for (int k = 0; k < 4; ++k) to[k] = a.v[k];
}
PH_INLINE Quad min(Quad a, Quad b) {
  for (int k = 0; k < 4; ++k) a.v[k] = min(a.v[k], b.v[k]);
  return a;
}
PH_INLINE Quad max(Quad a, Quad b) {
  for (int k = 0; k < 4; ++k) a.v[k] = max(a.v[k], b.v[k]);
  return a;
}
PH_INLINE void transpose(Quad& a, Quad& b, Quad& c, Quad& d) {
  Quad* const row[4] = {&a, &b, &c, &d};
  for (int i = 0; i < 4; ++i) {
    for (int k = 0; k < i; ++k) {
      const float t = row[i]->v[k];
      row[i]->v[k] = row[k]->v[i], row[k]->v[i] = t;
    }
  }
}
PH_INLINE Quad operator+(Quad a, Quad b) {
  return {{a.v[0] + b.v[0], a.v[1] + b.v[1], a.v[2] + b.v[2], a.v[3] + b.v[3]}};
}
PH_INLINE Quad operator-(Quad a, Quad b) {
  return {{a.v[0] - b.v[0], a.v[1] - b.v[1], a.v[2] - b.v[2], a.v[3] - b.v[3]}};
}
PH_INLINE Quad operator*(Quad a, float s) {
  return {{a.v[0] * s, a.v[1] * s, a.v[2] * s, a.v[3] * s}};
}
#endif

// The least and the most of each of three rows of sixteen, with no NaN among them.
PH_INLINE void extremes(const float (&row)[3][16], Vec3& least, Vec3& most) {
  Quad low[4], high[4];
  for (int k = 0; k < 3; ++k) {
    const Quad a = load_quad(row[k]), b = load_quad(row[k] + 4);
    const Quad c = load_quad(row[k] + 8), d = load_quad(row[k] + 12);
    low[k] = min(min(a, b), min(c, d)), high[k] = max(max(a, b), max(c, d));
  }
  low[3] = low[2], high[3] = high[2];
  transpose(low[0], low[1], low[2], low[3]);
  transpose(high[0], high[1], high[2], high[3]);
  float of[2][4];
  store(of[0], min(min(low[0], low[1]), min(low[2], low[3])));
  store(of[1], max(max(high[0], high[1]), max(high[2], high[3])));
  least = {of[0][0], of[0][1], of[0][2]}, most = {of[1][0], of[1][1], of[1][2]};
}
// Of one.
PH_INLINE float most(const float (&row)[16]) {
  float four[4];
  store(four,
        max(max(load_quad(row), load_quad(row + 4)), max(load_quad(row + 8), load_quad(row + 12))));
  return max(max(four[0], four[1]), max(four[2], four[3]));
}

// --- Sixteen lanes ----------------------------------------------------------------------------
inline constexpr int kParts = kLanes / kNative;

struct Lanes {
  Vf part[kParts];
};
struct LaneMask {
  Vm part[kParts];
};

PH_INLINE Lanes load(const float* p) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_load(p + k * kNative);
  return r;
}
PH_INLINE void store(float* p, const Lanes& a) {
  for (int k = 0; k < kParts; ++k) v_store(p + k * kNative, a.part[k]);
}
PH_INLINE Lanes all(float a) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_set(a);
  return r;
}
PH_INLINE Lanes operator+(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] + b.part[k];
  return r;
}
PH_INLINE Lanes operator-(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] - b.part[k];
  return r;
}
PH_INLINE Lanes operator*(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] * b.part[k];
  return r;
}
PH_INLINE Lanes operator/(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] / b.part[k];
  return r;
}
// min and max return b where either is NaN, as the x86 instructions do.
PH_INLINE Lanes min(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_min(a.part[k], b.part[k]);
  return r;
}
PH_INLINE Lanes max(const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_max(a.part[k], b.part[k]);
  return r;
}
PH_INLINE Lanes sqrt(const Lanes& a) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_sqrt(a.part[k]);
  return r;
}
PH_INLINE LaneMask operator<(const Lanes& a, const Lanes& b) {
  LaneMask r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_lt(a.part[k], b.part[k]);
  return r;
}
PH_INLINE LaneMask operator<=(const Lanes& a, const Lanes& b) {
  LaneMask r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_le(a.part[k], b.part[k]);
  return r;
}
PH_INLINE LaneMask operator&(const LaneMask& a, const LaneMask& b) {
  LaneMask r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_and(a.part[k], b.part[k]);
  return r;
}
PH_INLINE LaneMask operator|(const LaneMask& a, const LaneMask& b) {
  LaneMask r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_or(a.part[k], b.part[k]);
  return r;
}
PH_INLINE Lanes select(const LaneMask& m, const Lanes& a, const Lanes& b) {
  Lanes r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_select(m.part[k], a.part[k], b.part[k]);
  return r;
}
// Bit i is lane i.
PH_INLINE u32 bits(const LaneMask& m) {
  u32 r = 0;
  for (int k = 0; k < kParts; ++k) r |= v_bits(m.part[k]) << (k * kNative);
  return r;
}

#if !defined(__AVX512F__)  // which sorts instead (stack.h)
// Whole numbers.
struct LaneInts {
  Vi part[kParts];
};

// The bits of floats.
PH_INLINE LaneInts whole(const Lanes& a) {
  LaneInts r;
  for (int k = 0; k < kParts; ++k) r.part[k] = __builtin_bit_cast(Vi, a.part[k]);
  return r;
}
PH_INLINE LaneInts all(int a) { return whole(all(__builtin_bit_cast(float, a))); }
PH_INLINE LaneInts lane_numbers() {
  constexpr int kNumbers[kLanes] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  LaneInts r;
  compiler::copy(&r, kNumbers, sizeof r);
  return r;
}
PH_INLINE LaneInts operator&(const LaneInts& a, const LaneInts& b) {
  LaneInts r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] & b.part[k];
  return r;
}
PH_INLINE LaneInts operator|(const LaneInts& a, const LaneInts& b) {
  LaneInts r;
  for (int k = 0; k < kParts; ++k) r.part[k] = a.part[k] | b.part[k];
  return r;
}
PH_INLINE LaneMask operator<(const LaneInts& a, const LaneInts& b) {
  LaneMask r;
  for (int k = 0; k < kParts; ++k) r.part[k] = v_lt(a.part[k], b.part[k]);
  return r;
}
PH_INLINE LaneInts select(const LaneMask& m, const LaneInts& a, const LaneInts& b) {
  LaneInts r;
  for (int k = 0; k < kParts; ++k) {
    const Vf own = __builtin_bit_cast(Vf, a.part[k]), other = __builtin_bit_cast(Vf, b.part[k]);
    r.part[k] = __builtin_bit_cast(Vi, v_select(m.part[k], own, other));
  }
  return r;
}
// In all lanes.
PH_INLINE LaneInts least(const LaneInts& a) {
  Vi one = a.part[0];
  for (int k = 1; k < kParts; ++k) one = v_min(one, a.part[k]);
  one = v_least(one);
  LaneInts r;
  for (Vi& part : r.part) part = one;
  return r;
}
PH_INLINE int first(const LaneInts& a) { return v_first(a.part[0]); }
#endif

// Bit i: number i has 0 in some bits, after others were flipped.
PH_INLINE u32 zeros(const u32 (&numbers)[16], u32 flipped, u32 some) {
  u32 r = 0;
  for (int k = 0; k < kParts; ++k)
    r |= v_zeros(numbers + k * kNative, flipped, some) << (k * kNative);
  return r;
}
// Bit i: number i is this one.
PH_INLINE u32 equal(u32 one, const u32 (&numbers)[16]) { return zeros(numbers, one, ~0u); }
// Bit i: number i has any of some bits.
PH_INLINE u32 any_of(u32 some, const u32 (&numbers)[16]) {
  return zeros(numbers, 0, some) ^ 0xffffu;
}

// The lowest n bits of those that are set.
PH_INLINE u32 lowest_bits(u32 m, u32 n) {
#if defined(__AVX512F__)  // AMD's with AVX2 alone may take hundreds of cycles for it
  return _pdep_u32((1u << n) - 1, m);
#else
  u32 r = 0;
  for (; n != 0 && m != 0; --n, m &= m - 1) r |= m & (~m + 1);
  return r;
#endif
}

// Lanes that are to be had of others: `to` a bit for each, `from` those of the others, as many.
struct LaneMoves {
  u32 to, from;
};

// What `move` and `fill` do at a time: all that are to be had or, without AVX-512, one.
#if defined(__AVX512F__)
struct LaneMove {
  __mmask16 to;
  __m512i from;  // of each lane in `to` the other's number
};
#else
struct LaneMove {
  u32 to, from;  // numbers of lanes
};
#endif
template <class F>
PH_INLINE void for_each_move(const LaneMoves& m, F&& f) {
#if defined(__AVX512F__)
  const __mmask16 to = static_cast<__mmask16>(m.to), from = static_cast<__mmask16>(m.from);
  const __m512i number = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  f(LaneMove{to, _mm512_maskz_expand_epi32(to, _mm512_maskz_compress_epi32(from, number))});
#else
  for (u32 to = m.to, from = m.from; to != 0; to &= to - 1, from &= from - 1) {
    f(LaneMove{compiler::trailing_zeros(to), compiler::trailing_zeros(from)});
  }
#endif
}
template <class T>
PH_INLINE void move(T (&to)[16], const T (&from)[16], const LaneMove& m) {
  static_assert(sizeof(T) == 4 || sizeof(T) == 8);
#if defined(__AVX512F__)
  if constexpr (sizeof(T) == 8) {
    const __m512i low = _mm512_loadu_si512(from), high = _mm512_loadu_si512(from + 8);
    const __m512i first = _mm512_cvtepu32_epi64(_mm512_castsi512_si256(m.from));
    const __m512i second = _mm512_cvtepu32_epi64(_mm512_extracti64x4_epi64(m.from, 1));
    _mm512_storeu_si512(to,
                        _mm512_mask_blend_epi64(static_cast<__mmask8>(m.to), _mm512_loadu_si512(to),
                                                _mm512_permutex2var_epi64(low, first, high)));
    _mm512_storeu_si512(to + 8, _mm512_mask_blend_epi64(
                                    static_cast<__mmask8>(m.to >> 8), _mm512_loadu_si512(to + 8),
                                    _mm512_permutex2var_epi64(low, second, high)));
  } else {
    // Other than above by a masked store: which is faster was measured (docs/performance.md).
    _mm512_mask_storeu_epi32(to, m.to, _mm512_permutexvar_epi32(m.from, _mm512_loadu_si512(from)));
  }
#else
  to[m.to] = from[m.from];
#endif
}

// One number to the lanes that are moved to.
template <class T>
PH_INLINE void fill(T (&to)[16], T value, const LaneMove& m) {
  static_assert(sizeof(T) == 4);
#if defined(__AVX512F__)
  _mm512_mask_storeu_epi32(to, m.to, _mm512_set1_epi32(__builtin_bit_cast(int, value)));
#else
  to[m.to] = value;
#endif
}

// Index of the lowest set bit; the argument is not 0.
PH_INLINE u32 lowest_bit(u32 m) { return compiler::trailing_zeros(m); }

// Calls f with the index of each bit that is set, from the lowest on.
template <class F>
PH_INLINE void for_each_bit(u32 m, F&& f) {
  for (; m != 0; m &= m - 1) f(lowest_bit(m));
}

}  // namespace parhelion::PH_ISA
