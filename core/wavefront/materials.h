// Materials: their types, the frames in which they scatter, and the numbers that this takes.
#pragma once
#include "wave.h"

namespace parhelion::PH_ISA {

// The paths, a bit for each, at surfaces of each type of material; and which of them are plain.
struct Kinds {
  u32 lanes[kMaterialKinds] = {};
  u32 plain = 0, transmitting = 0;
};

// Calls f.operator()<Material>(lanes) for each type that there is.
template <class F>
PH_INLINE void for_each_kind(const Kinds& kinds, F&& f) {
#define MATERIAL(name, Type)                                                        \
  if (kinds.lanes[static_cast<u32>(MaterialKind::name)] != 0) {                     \
    f.template operator()<Type>(kinds.lanes[static_cast<u32>(MaterialKind::name)]); \
  }
#include "../materials.def"
#undef MATERIAL
}

// A path's material, whose parameters may depend on what the path is inside of: sets its block.
template <class Material>
PH_INLINE Fate enter_material(const SceneView& scene, Paths& p, Vertices& v, u32 k) {
  if constexpr (kTransmits<Material>) {
    const MaterialRecord& record = *v.record[k];
    Material material = from_block<Material>(*v.block[k]);
    bool changed = record.priority != 0;
    if constexpr (requires { material.dispersion; }) {
      if (material.dispersion > 0.0f) {
        if (!disperse(p, k, material)) return Fate::ends;
        changed = true;
      }
    }
    if (changed) {
      if (!enter_boundary(scene, p.media[k], record, v.front[k] != 0, material)) {
        // Within a body that takes precedence this surface is not there. It does stop the rays that
        // ask for light, so what lies behind it is found by scattering alone.
        p.scatter_pdf[k] = 0.0f;
        p.set_ray(k, ray_from(v.surface(k, p.slot[k]), p.direction.at(k)));
        return Fate::passes;
      }
      if (v.block[k] != &v.own[k]) v.own[k] = *v.block[k];
      v.block[k] = &v.own[k];
      to_block(material, v.own[k]);
    }
  }
  return Fate::scatters;
}

// The frames in which surfaces scatter, whose normal is in n. Opaque ones are the same from their
// other side.
PH_APART inline void find_frames(const Rows<Vec3, kBatch>& __restrict n,
                                 const u32 (&__restrict opaque)[kBatch],
                                 const Paths& __restrict paths, Vertices& __restrict v) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 normal = v.normal.at(k), wo = -paths.direction.at(k);
    const bool behind = v.front[k] == 0;
    Frame f = frame_around(bent_normal(n.at(k), normal, wo));
    const float side = (behind & (opaque[k] != 0)) ? -1.0f : 1.0f;
    f.y *= side;
    f.z *= side;
    v.frame.set(k, f);
    v.local_wo.set(k, to_local(f, wo));
    const Vec3 facing = normal * (behind ? -1.0f : 1.0f);
    const Vec3 none = {0, 0, 0};
    v.receiver.set(k, Receiver{v.point.at(k), select(opaque[k] != 0, facing, none)});
  }
}

// From which side of the surface, and with which parameters and frame, paths see their materials.
// Returns the lanes of those that scatter; asking: of those of them that ask for light.
template <class Watch>
inline u32 approach(const SceneView& scene, Wave& wave, Vertices& v, u32 lanes, Kinds& kinds,
                    u32& asking, const Watch& watch) {
  Paths& p = wave.paths;
  Rows<Vec3, kBatch> n = v.shading;
  Vec3 along[kBatch];
  u32 opaque[kBatch], turned = 0, scattering = 0;
  for_each_bit(lanes, [&](u32 k) {
    kinds.lanes[v.block[k]->kind] |= 1u << k;
    if (!v.record[k]->uses_uv) return;
    const MappedNormal mapped =
        mapped_normal(scene, *v.record[k], v.surface(k, p.slot[k]), p.width[k]);
    n.set(k, mapped.normal);
    along[k] = mapped.along;
    turned |= 1u << k;
  });
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    if (kTransmits<Material>) kinds.transmitting |= own;
  });
  spread(~kinds.transmitting, opaque);
  find_frames(n, opaque, p, v);
  for_each_bit(turned, [&](u32 k) {
    const float side = opaque[k] != 0 && v.front[k] == 0 ? -1.0f : 1.0f;
    const Frame f = frame_along(v.frame.at(k).z * side, along[k]);
    v.frame.set(k, Frame{f.x, f.y * side, f.z * side});
    v.local_wo.set(k, to_local(v.frame.at(k), -p.direction.at(k)));
  });
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    for_each_bit(own, [&](u32 k) {
      if (wave.features && p.depth[k] == 1) {
        const bool behind = opaque[k] != 0 && v.front[k] == 0;
        wave.features[k].albedo = albedo_of(from_block<Material>(*v.block[k]));
        wave.features[k].shading_normal = v.frame.at(k).z * (behind ? -1.0f : 1.0f);
      }
      const Fate fate = enter_material<Material>(scene, p, v, k);
      watch(Step::approaches, wave, &v, k, fate);
      if (fate == Fate::ends) wave.alive &= ~(1u << k);
      if (fate != Fate::scatters) return;
      scattering |= 1u << k;
      const Material material = from_block<Material>(*v.block[k]);
      if (asks_for_light(scene) && !is_delta(material)) asking |= 1u << k;
      if constexpr (requires { is_plain(material); }) {
        if (is_plain(material)) {
          kinds.plain |= 1u << k;
          v.plain.set(k, plain(material));
        }
      }
    });
  });
  for (u32& own : kinds.lanes) own &= scattering;
  return scattering;
}

// The numbers that a bounce takes, by draw and lane.
struct BounceDraws {
  float choice[2][kBatch], point[2][kBatch], direction[2][kBatch];
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
    draw2(s, kDrawLight, draws.choice[0], draws.choice[1]);
    draw2(s, kDrawLightPoint, draws.point[0], draws.point[1]);
  }
  for (u32 k = 0; k < kBatch; ++k) {
    draws.hemisphere.set(k, cosine_hemisphere({draws.direction[0][k], draws.direction[1][k]}));
  }
}

}  // namespace parhelion::PH_ISA
