// A thin matte sheet that light comes through as it comes back: leaves, paper, lamp shades. Both
// sides follow Lambert's cosine law.
#pragma once
#include "../bsdf.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

struct DiffuseTransmission {
  Vec3 color, transmittance;

  static constexpr bool transmits = true;
  static constexpr bool thin = true;  // has no inside
  static constexpr const char* doc = "thin matte sheet: light scatters back and comes through";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.4f, 0.4f, 0.4f}, 0.0f, 1.0f, "share of the light that is reflected"},
      {"transmittance",
       3,
       {0.4f, 0.4f, 0.4f},
       0.0f,
       1.0f,
       "share that comes through; less where both are more than 1"},
  };
};

PH_INLINE bool is_delta(const DiffuseTransmission&) { return false; }

// What comes through, of what is not reflected.
PH_INLINE Vec3 through(const DiffuseTransmission& m) {
  return {min(m.transmittance.x, 1.0f - m.color.x), min(m.transmittance.y, 1.0f - m.color.y),
          min(m.transmittance.z, 1.0f - m.color.z)};
}

PH_INLINE Vec3 albedo(const DiffuseTransmission& m) { return m.color + through(m); }

// Chance that a sample is reflected.
PH_INLINE float reflected_chance(const DiffuseTransmission& m) {
  const float back = max_component(m.color), on = max_component(through(m));
  return back + on > 0.0f ? back / (back + on) : 1.0f;
}

PH_INLINE float pdf(const DiffuseTransmission& m, Vec3 wo, Vec3 wi) {
  const float back = reflected_chance(m);
  const float cosine = cosine_hemisphere_pdf({wi.x, wi.y, abs(wi.z)});
  return (wo.z * wi.z > 0.0f ? back : 1.0f - back) * cosine;
}

PH_INLINE Vec3 eval(const DiffuseTransmission& m, Vec3 wo, Vec3 wi) {
  const Vec3 share = wo.z * wi.z > 0.0f ? m.color : through(m);
  return share * cosine_hemisphere_pdf({wi.x, wi.y, abs(wi.z)});
}

PH_INLINE bool sample(const DiffuseTransmission& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const float back = reflected_chance(m);
  Vec2 number = u.direction;
  const bool reflects = first_lobe(back, 1.0f - back, number);
  const float chance = reflects ? back : 1.0f - back;
  out.wi = cosine_hemisphere(number);
  out.pdf = chance * cosine_hemisphere_pdf(out.wi);
  out.wi.z = copysign(out.wi.z, reflects ? wo.z : -wo.z);
  out.weight = (reflects ? m.color : through(m)) * (1.0f / chance);
  return out.pdf > 0.0f;
}

}  // namespace parhelion::PH_ISA
