// The random numbers of a bounce.
#pragma once
#include "kinds.h"

namespace parhelion::PH_ISA {

// The numbers that a bounce takes, by draw and lane.
struct BounceDraws {
  float light[kBatch], point[2][kBatch], direction[2][kBatch];
  Rows<Vec3, kBatch> hemisphere;
  float lobe[kBatch], lobe2[kBatch], roulette[kBatch];

  PH_INLINE BsdfDraws bsdf(u32 i) const {
    return {{direction[0][i], direction[1][i]}, hemisphere.at(i), lobe[i], lobe2[i]};
  }
};

// All that scattering may need at surfaces of these kinds.
inline void draw_bounces(Paths& paths, const Kinds& kinds, bool lit, BounceDraws& draws) {
  SamplerBatch<kBatch>& s = paths.samplers;
  u32 lobes = 0, deepest = 0;
  for_each_kind(kinds, [&]<class Material>(u32) {
    constexpr u32 own = lobe_draws<Material>();
    lobes = own > lobes ? own : lobes;
  });
  for (u32 k = 0; k < kBatch; ++k) {
    s.dimension[k] = bounce_draw(paths.depth[k]);
    deepest = paths.depth[k] > deepest ? paths.depth[k] : deepest;
  }
  draw2(s, kDrawDirection, draws.direction[0], draws.direction[1]);
  if (lobes > 0) draw1(s, kDrawLobe, draws.lobe);
  if (lobes > 1) draw1(s, kDrawLobe2, draws.lobe2);
  if (deepest >= kRouletteStart) draw1(s, kDrawRoulette, draws.roulette);
  if (lit) {
    draw1(s, kDrawLight, draws.light);
    draw2(s, kDrawLightPoint, draws.point[0], draws.point[1]);
  }
  for (u32 k = 0; k < kBatch; ++k) {
    draws.hemisphere.set(k, cosine_hemisphere({draws.direction[0][k], draws.direction[1][k]}));
  }
}

}  // namespace parhelion::PH_ISA
