// How much of unpolarised light a smooth interface reflects.
#pragma once
#include "math.h"

namespace parhelion::PH_ISA {

// A dielectric interface met at the cosine `cos_i` >= 0; eta is the far index over the near one.
struct Fresnel {
  float reflected;  // share of the power; 1 at total reflection
  float cos_t;      // cosine of the refracted direction, >= 0; 0 at total reflection
};

PH_INLINE Fresnel fresnel_dielectric(float cos_i, float eta) {
  const float sin2_t = (1.0f - cos_i * cos_i) / (eta * eta);
  const float cos_t = safe_sqrt(1.0f - sin2_t);
  const float parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
  const float perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
  const float reflected =
      sin2_t >= 1.0f ? 1.0f : 0.5f * (parallel * parallel + perpendicular * perpendicular);
  return {reflected, cos_t};
}

// A metal of index eta + i k, relative to what surrounds it. Equations: M. Born and E. Wolf,
// Principles of Optics, 14.4, in real numbers. eta = 0 reflects everything, exactly.
PH_INLINE float fresnel_conductor(float cos_i, float eta, float k) {
  const float cos2 = cos_i * cos_i, sin2 = 1.0f - cos2;
  // (a + i b)^2 = (eta + i k)^2 - sin^2, of which a^2 would cancel where absorption prevails
  const float real = eta * eta - k * k - sin2;
  const float cross = 4.0f * eta * eta * k * k;
  const float size = sqrt(real * real + cross);
  const float absorbed = 0.5f * cross / max(size - real, 1e-30f);
  const float a2 = real > 0.0f ? 0.5f * (size + real) : absorbed;
  const float a = 2.0f * cos_i * sqrt(a2);
  const float s = (size + cos2 - a) / (size + cos2 + a + 1e-30f);
  const float q = cos2 * size + sin2 * sin2;
  const float p = (q - a * sin2) / max(q + a * sin2, 1e-30f);
  return 0.5f * s * (1.0f + p);
}

PH_INLINE Vec3 fresnel_conductor(float cos_i, Vec3 eta, Vec3 k) {
  return {fresnel_conductor(cos_i, eta.x, k.x), fresnel_conductor(cos_i, eta.y, k.y),
          fresnel_conductor(cos_i, eta.z, k.z)};
}

// F0 + (1 - F0) (1 - cos)^5. C. Schlick, "An Inexpensive BRDF Model", 1994.
PH_INLINE float schlick_weight(float cos_i) {
  const float x = clamp(1.0f - cos_i, 0.0f, 1.0f), x2 = x * x;
  return x2 * x2 * x;
}

}  // namespace parhelion::PH_ISA
