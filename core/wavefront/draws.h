// The random numbers of a bounce.
#pragma once
#include "kinds.h"

namespace parhelion::PH_ISA {

// The numbers that a bounce takes, by draw and lane.
struct BounceDraws {
  float light[kBatch], point[2][kBatch], direction[2][kBatch];
  float lobe[kBatch], roulette[kBatch];

  PH_INLINE BsdfDraws bsdf(u32 i) const { return {{direction[0][i], direction[1][i]}, lobe[i]}; }
};

// Has the next numbers be those of a bounce.
PH_INLINE void turn_to_bounce(Paths& p) {
  for (u32 k = 0; k < kBatch; ++k) p.samplers.dimension[k] = bounce_draw(p.depth[k]);
}

// All that scattering may need at surfaces of these kinds.
inline void draw_bounces(Paths& paths, const Kinds& kinds, bool lit, BounceDraws& draws) {
  turn_to_bounce(paths);
  const SamplerBatch<kBatch>& s = paths.samplers;
  bool lobes = false;
  u32 deepest = 0;
  for_each_kind(kinds, [&]<class Material>(u32) { lobes |= LobeDraws<Material>; });
  for (u32 k = 0; k < kBatch; ++k) {
    deepest = paths.depth[k] > deepest ? paths.depth[k] : deepest;
  }
  draw2(s, kDrawDirection, draws.direction[0], draws.direction[1]);
  if (lobes) draw1(s, kDrawLobe, draws.lobe);
  if (deepest >= kRouletteStart) draw1(s, kDrawRoulette, draws.roulette);
  if (lit) {
    draw1(s, kDrawLight, draws.light);
    draw2(s, kDrawLightPoint, draws.point[0], draws.point[1]);
  }
}

}  // namespace parhelion::PH_ISA
