// Elementary functions that libm would otherwise give, made of +, -, *, / and sqrt alone so that
// they have the same bits everywhere (see math.h). Relative errors are below 3e-7 unless said
// otherwise; NaN gives NaN. The coefficients are minimax fits of our own (Lawson's algorithm).
#pragma once
#include "math.h"

namespace parhelion::PH_ISA {

inline constexpr float kNan = __builtin_bit_cast(float, 0x7fc00000u);
inline constexpr float kLog2E = 1.44269504f;

// The nearest whole number, halves away from 0, of a number below 2^31 in size.
PH_INLINE int round_to_int(float x) { return static_cast<int>(x + copysign(0.5f, x)); }

// Without branches, of a number below 2^31 in size.
PH_INLINE float floor_within(float x) {
  const float whole = static_cast<float>(static_cast<int>(x));
  return whole - (whole > x ? 1.0f : 0.0f);
}

PH_INLINE float floor(float x) {
  return abs(x) < 0x1p23f ? floor_within(x) : x;  // whole already, or not a number
}

// Without branches: x - floor(x), 0 of what is not finite.
PH_INLINE float fraction(float x) {
  const u32 kept = abs(x) < 0x1p23f ? ~0u : 0u;  // others are whole, and a choice becomes a branch
  const float y = __builtin_bit_cast(float, __builtin_bit_cast(u32, x) & kept);
  return y - floor_within(y);
}

// x 2^n for n in [-252, 254], in two steps since 2^n itself may not be a normal number.
PH_INLINE float scale_by_power(float x, int n) {
  const int half = n / 2;
  const auto power = [](int k) {
    return __builtin_bit_cast(float, static_cast<u32>(k + 127) << 23);
  };
  return x * power(half) * power(n - half);
}

// e^r for |r| <= ln(2) / 2.
PH_INLINE float exp_reduced(float r) {
  const float p =
      0.4999999404f +
      r * (0.1666651964f + r * (4.166839272e-2f + r * (8.368780836e-3f + r * 1.381446491e-3f)));
  return 1.0f + (r + r * r * p);
}

// Without branches, for x in [-104, 88.8].
PH_INLINE float exp_within(float x) {
  const int n = round_to_int(x * kLog2E);
  const float m = static_cast<float>(n);
  // ln 2 in two parts, the first of so few bits that its product with n is exact
  return scale_by_power(exp_reduced((x - m * 0.693359375f) + m * 2.12194440e-4f), n);
}

PH_INLINE float exp(float x) {
  if (x > 88.8f) return kInfinity;
  if (!(x > -104.0f)) return x == x ? 0.0f : x;
  return exp_within(x);
}

// x = m 2^n with m in [sqrt(1/2), sqrt(2)), for finite x > 0.
struct PowerSplit {
  float m;
  int n;
};

PH_INLINE PowerSplit split_power(float x) {
  const bool tiny = x < 0x1p-126f;
  const u32 bits = __builtin_bit_cast(u32, tiny ? x * 0x1p24f : x);
  // 0x3f3504f3 is sqrt(1/2): above its mantissa the exponent counts one more.
  const u32 shifted = bits - 0x3f3504f3u;
  const int n = static_cast<int>(shifted) >> 23;
  return {__builtin_bit_cast(float, (shifted & 0x007fffffu) + 0x3f3504f3u), tiny ? n - 24 : n};
}

// ln(1 + f) for 1 + f in [sqrt(1/2), sqrt(2)]: 2 artanh(s) with s = f / (2 + f), arranged so that
// f, which is exact, carries most of it.
PH_INLINE float log_reduced(float f) {
  const float s = f / (2.0f + f), q = s * s;
  const float p =
      q * (0.6666666269f + q * (0.4000033736f + q * (0.2853723764f + q * 0.2358357161f)));
  // 2 s = f - s f
  return f - s * (f - p);
}

// Without branches, for finite x > 0.
PH_INLINE float log_within(float x) {
  const PowerSplit a = split_power(x);
  const float n = static_cast<float>(a.n);
  return n * 0.693359375f + (log_reduced(a.m - 1.0f) - n * 2.12194440e-4f);
}

PH_INLINE float log(float x) {
  if (!(x > 0.0f)) return x == 0.0f ? -kInfinity : kNan;
  return x == kInfinity ? x : log_within(x);
}

// Without branches, for finite x > 0.
PH_INLINE float log2_within(float x) {
  const PowerSplit a = split_power(x);
  return static_cast<float>(a.n) + log_reduced(a.m - 1.0f) * kLog2E;
}

PH_INLINE float log2(float x) {
  if (!(x > 0.0f)) return x == 0.0f ? -kInfinity : kNan;
  return x == kInfinity ? x : log2_within(x);
}

// x^y for x >= 0. In double: an error of the logarithm counts y log(x) times in the power. Series
// of the logarithm and the exponential, cut where their rests are below 1e-10.
PH_INLINE float pow(float x, float y) {
  if (y == 0.0f || x == 1.0f) return 1.0f;
  if (!(x >= 0.0f) || y != y) return kNan;
  if (x == 0.0f || x == kInfinity) return (x == 0.0f) == (y > 0.0f) ? 0.0f : kInfinity;
  const PowerSplit a = split_power(x);
  const double m = static_cast<double>(a.m), s = (m - 1.0) / (m + 1.0), q = s * s;
  const double artanh =
      s * (1.0 +
           q * (1.0 / 3 + q * (1.0 / 5 + q * (1.0 / 7 + q * (1.0 / 9 + q * (1.0 / 11 + q / 13))))));
  const double exponent = static_cast<double>(y) * (a.n + artanh * 2.8853900817779268);  // 2 / ln 2
  if (exponent >= 128.0) return kInfinity;
  if (!(exponent > -151.0)) return 0.0f;
  const int n = static_cast<int>(exponent + (exponent < 0.0 ? -0.5 : 0.5));
  const double r = (exponent - n) * 0.69314718055994531;
  double e = 1.0;
  for (int k = 9; k >= 1; --k) e = 1.0 + e * r / k;
  return scale_by_power(static_cast<float>(e), n);
}

// The angle of (x, y) from the x axis in radians, in [-pi, pi]; 0 for (0, 0).
PH_INLINE float atan2(float y, float x) {
  const float a = abs(x), b = abs(y);
  const float high = max(a, b), low = min(a, b);
  const float t = low == kInfinity ? 1.0f : low / (high == 0.0f ? 1.0f : high), q = t * t;
  const float p =
      -0.3333316743f +
      q * (0.1999413669f +
           q * (-0.1421420574f +
                q * (0.1067892909f +
                     q * (-7.580552995e-2f +
                          q * (4.355324060e-2f + q * (-1.658099703e-2f + q * 2.974543255e-3f))))));
  const float acute = t + t * q * p;
  const float upper = b > a ? 0.5f * kPi - acute : acute;
  const float angle = copysign(x < 0.0f ? kPi - upper : upper, y);
  return x != x || y != y ? kNan : angle;
}

// asin of x in [0, 1/2].
PH_INLINE float asin_reduced(float x) {
  const float q = x * x;
  const float p =
      0.1666675359f +
      q * (7.495240867e-2f + q * (4.547722265e-2f + q * (2.414694987e-2f + q * 4.221974313e-2f)));
  return x + x * q * p;
}

// In radians. Arguments outside [-1, 1], which rounding makes, count as the nearer end.
PH_INLINE float asin(float x) {
  const float a = min(abs(x), 1.0f);
  const float angle =
      a <= 0.5f ? asin_reduced(a) : 0.5f * kPi - 2.0f * asin_reduced(sqrt(0.5f * (1.0f - a)));
  return x == x ? copysign(angle, x) : x;
}

PH_INLINE float acos(float x) {
  if (x != x) return x;
  const float a = min(abs(x), 1.0f);
  if (a <= 0.5f) return 0.5f * kPi - copysign(asin_reduced(a), x);
  const float angle = 2.0f * asin_reduced(sqrt(0.5f * (1.0f - a)));
  return x < 0.0f ? kPi - angle : angle;
}

// erf of x in [-1, 1].
PH_INLINE float erf_reduced(float x) {
  const float q = x * x;
  return x * (1.128379107f +
              q * (-0.3761232495f +
                   q * (0.1128017977f +
                        q * (-2.671131119e-2f + q * (4.917550832e-3f - q * 5.631418899e-4f)))));
}

// -ln(1 - erf(a)), which is smooth, for a in [1, 4].
PH_INLINE float erfc_exponent(float a) {
  return 3.415125830e-4f +
         a * (1.127089262f +
              a * (0.6381447315f +
                   a * (0.1031068191f +
                        a * (-2.183809690e-2f + a * (2.947666682e-3f - a * 1.863800862e-4f)))));
}

// erf, without branches, for a in [0, 4], to 2e-7: what lies below 1 and what lies beyond, which is
// 1 - erf(1) less 1 - erf(a). Even minima would become branches.
PH_INLINE float erf_within(float a) {
  const float sum = a + 1.0f, gap = abs(a - 1.0f);
  const float low = 0.5f * (sum - gap), high = 0.5f * (sum + gap);  // of a and 1
  return erf_reduced(low) + (0.157299207f - exp_within(-erfc_exponent(high)));
}

// The x whose erf is y, without branches, for y in [-1 + 2^-24, 1 - 2^-24]. Relative error below
// 6e-7. Method: M. Giles, "Approximating the erfinv function", GPU Computing Gems, 2011:
// erf_inverse(y) / y is smooth in w = -ln(1 - y^2).
PH_INLINE float erf_inverse_within(float y) {
  const float w = -log_within((1.0f - y) * (1.0f + y));
  const float t = w - 2.5f, s = sqrt(w) - 3.0f;
  const float middle =
      1.501409411f +
      t * (0.2466407269f +
           t * (-4.177707713e-3f +
                t * (-1.253707567e-3f +
                     t * (2.186021884e-4f +
                          t * (-4.396781605e-6f +
                               t * (-3.528858997e-6f +
                                    t * (3.437270948e-7f + t * 2.853474790e-8f)))))));
  const float tail =
      2.832976818f +
      s * (1.001674056f +
           s * (9.439355694e-3f +
                s * (-7.621414028e-3f +
                     s * (5.736475345e-3f +
                          s * (-3.677002154e-3f +
                               s * (1.355891931e-3f +
                                    s * (1.043110969e-4f - s * 2.049753093e-4f)))))));
  return y * (w < 5.0f ? middle : tail);
}

}  // namespace parhelion::PH_ISA
