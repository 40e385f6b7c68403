// Lambert's cosine law: the same radiance in every direction.
#pragma once
#include "../bsdf.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

struct Diffuse {
  Vec3 color;

  static constexpr const char* doc = "matte: Lambert's cosine law, on both sides";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.8f, 0.8f, 0.8f}, 0.0f, 1.0f, "share of the light that is reflected"},
  };
};

PH_INLINE bool is_delta(const Diffuse&) { return false; }

PH_INLINE float pdf(const Diffuse&, Vec3 wo, Vec3 wi) {
  return wo.z * wi.z > 0.0f ? cosine_hemisphere_pdf({wi.x, wi.y, abs(wi.z)}) : 0.0f;
}

PH_INLINE Vec3 eval(const Diffuse& m, Vec3 wo, Vec3 wi) { return m.color * pdf(m, wo, wi); }

PH_INLINE bool sample(const Diffuse& m, Vec3 wo, const Sampler& sampler, u32 draw,
                      BsdfSample& out) {
  out.wi = cosine_hemisphere(draw2(sampler, draw + kDrawDirection));
  out.pdf = cosine_hemisphere_pdf(out.wi);
  out.wi.z = copysign(out.wi.z, wo.z);
  out.weight = m.color;
  return out.pdf > 0.0f;
}

}  // namespace parhelion::PH_ISA
