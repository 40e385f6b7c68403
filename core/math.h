// Vector algebra and the few functions that would otherwise come from libm.
//
// libm picks other code on other processors, so its last bits differ; these are made of +, -, *, /
// and sqrt alone, which IEEE 754 rounds the same way everywhere.
#pragma once
#include "types.h"

namespace parhelion::PH_ISA {

PH_INLINE float min(float a, float b) { return a < b ? a : b; }
PH_INLINE float max(float a, float b) { return a > b ? a : b; }
PH_INLINE float clamp(float x, float low, float high) { return max(low, min(x, high)); }
// The same for low >= 0, by bits, whose order as whole numbers is that of floats which are not
// negative; a NaN counts as low or high by its sign. Of clamp compilers make branches, to work out
// apart what follows on a bound, and loops with branches are no vectors.
PH_INLINE float clamp_positive(float x, float low, float high) {
  const int least = __builtin_bit_cast(int, low), most = __builtin_bit_cast(int, high);
  const int bits = __builtin_bit_cast(int, x), below = bits < most ? bits : most;
  return __builtin_bit_cast(float, below > least ? below : least);
}
PH_INLINE float abs(float x) { return compiler::abs(x); }
PH_INLINE double abs(double x) { return x < 0.0 ? -x : x; }
PH_INLINE float sqrt(float x) { return compiler::sqrt(x); }
PH_INLINE float safe_sqrt(float x) { return sqrt(max(x, 0.0f)); }
PH_INLINE float copysign(float size, float sign) { return compiler::copysign(size, sign); }
PH_INLINE bool finite(float x) { return abs(x) < kInfinity; }  // false for NaN

PH_INLINE Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
PH_INLINE Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
PH_INLINE Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
PH_INLINE Vec3 operator*(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
PH_INLINE Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
PH_INLINE Vec3& operator+=(Vec3& a, Vec3 b) { return a = a + b; }
PH_INLINE Vec3& operator*=(Vec3& a, Vec3 b) { return a = a * b; }
PH_INLINE Vec3& operator*=(Vec3& a, float s) { return a = a * s; }
PH_INLINE float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
PH_INLINE Vec3 cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
PH_INLINE float length(Vec3 a) { return sqrt(dot(a, a)); }
PH_INLINE Vec3 normalize(Vec3 a) { return a * (1.0f / length(a)); }
// Of a vector that is of unit length but for rounding: a Newton step, cheaper than a root.
PH_INLINE Vec3 renormalize(Vec3 a) { return a * (1.5f - 0.5f * dot(a, a)); }
PH_INLINE float max_component(Vec3 a) { return max(a.x, max(a.y, a.z)); }
// Without a branch.
PH_INLINE Vec3 select(bool which, Vec3 a, Vec3 b) {
  return {which ? a.x : b.x, which ? a.y : b.y, which ? a.z : b.z};
}
// In one comparison: of what is not finite the difference from itself is NaN.
PH_INLINE bool finite(Vec3 a) { return (a.x - a.x) + (a.y - a.y) + (a.z - a.z) == 0.0f; }
PH_INLINE bool black(Vec3 a) { return (a.x == 0.0f) & (a.y == 0.0f) & (a.z == 0.0f); }

// Rec. 709 luminance of a linear colour.
PH_INLINE float luminance(Vec3 c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }

// cos and sin of 2 pi u, for u in [0, 1], to 1e-7. The argument is reduced exactly to an eighth of
// a turn. Coefficients: the minimax polynomials of S. Moshier's Cephes library, sinf.c.
struct CosSin {
  float c, s;
};

PH_INLINE CosSin cos_sin_turns(float u) {
  const int quarter = static_cast<int>(4.0f * u + 0.5f);
  const float x = (2.0f * kPi) * (u - 0.25f * static_cast<float>(quarter));
  const float x2 = x * x, x4 = x2 * x2;
  const float s =
      x + x * x2 * ((-1.6666654611e-1f + 8.3321608736e-3f * x2) - 1.9515295891e-4f * x4);
  const float c = (1.0f - 0.5f * x2) +
                  x4 * ((4.1666645683e-2f - 1.3887316255e-3f * x2) + 2.4433157118e-5f * x4);
  const bool odd = (quarter & 1) != 0;
  const float a = odd ? s : c;
  const float b = odd ? c : s;
  return {((quarter + 1) & 2) != 0 ? -a : a, (quarter & 2) != 0 ? -b : b};
}

// cos and sin of pi x in double, for x >= 0, each to its full relative precision.
struct DCosSin {
  double c, s;
};

inline DCosSin cos_sin_pi(double x) {
  const int quarter = static_cast<int>(2.0 * x + 0.5);
  const double a = (x - 0.5 * quarter) * 3.14159265358979323846;
  double c = 1.0, s = 1.0;
  for (int k = 18; k >= 2; k -= 2) {
    c = 1.0 - c * a * a / ((k - 1) * k);
    s = 1.0 - s * a * a / (k * (k + 1));
  }
  s *= a;
  switch (quarter & 3) {
    case 0: return {c, s};
    case 1: return {-s, c};
    case 2: return {-c, -s};
    default: return {s, -c};
  }
}
inline double cos_pi(double x) { return cos_sin_pi(x).c; }

// An orthonormal frame around a unit normal, which is its z axis.
// Method: Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
struct Frame {
  Vec3 x, y, z;
};

PH_INLINE Frame frame_around(Vec3 n) {
  const float sign = copysign(1.0f, n.z);
  const float a = -1.0f / (sign + n.z);
  const float b = n.x * n.y * a;
  return {{1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}, n};
}

// One around a unit normal whose x axis lies as near to `along` as can be.
PH_INLINE Frame frame_along(Vec3 n, Vec3 along) {
  const Vec3 x = along - n * dot(n, along);
  const float size = dot(x, x);
  if (!(size > 1e-12f * dot(along, along))) return frame_around(n);
  const Vec3 unit = x * (1.0f / sqrt(size));
  return {unit, cross(n, unit), n};
}

PH_INLINE Vec3 to_world(const Frame& f, Vec3 v) { return f.x * v.x + f.y * v.y + f.z * v.z; }
PH_INLINE Vec3 to_local(const Frame& f, Vec3 v) { return {dot(f.x, v), dot(f.y, v), dot(f.z, v)}; }

}  // namespace parhelion::PH_ISA
