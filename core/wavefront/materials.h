// Materials: the frames and parameters by which paths see them.
#pragma once
#include "kinds.h"
#include "watch.h"

namespace parhelion::PH_ISA {

// A path's material, whose parameters may depend on what the path is inside of: sets its block.
template <class Material>
PH_INLINE Fate enter_material(const SceneView& scene, Paths& p, Vertices& v, u32 k) {
  if constexpr (kTransmits<Material>) {
    const MaterialRecord& record = *v.record[k];
    Material material = v.parameters<Material>(k);
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
        p.set_ray(k, ray_from(v.surface(k, p.slot.at(k)), p.direction.at(k)));
        return Fate::passes;
      }
      if (v.block[k] != &v.own[k]) v.own[k] = *v.block[k];
      v.block[k] = &v.own[k];
      to_block(material, v.own[k]);
    }
  }
  return Fate::scatters;
}

// Which of some paths see a normal in n that has to be bent: few, so that frames are mostly found
// without that.
PH_APART inline u32 find_bent(const Rows<Vec3, kBatch>& __restrict n, u32 lanes,
                              const Paths& __restrict paths, const Vertices& __restrict v) {
  u32 bent[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    bent[k] = is_bent(n.at(k), v.normal.at(k), -paths.direction.at(k)) ? 1 : 0;
  }
  return having(1, bent, lanes);
}

// The frames in which surfaces scatter, whose normal is in n. Opaque ones are the same from their
// other side.
template <bool kBent>
PH_APART inline void find_frames(const Rows<Vec3, kBatch>& __restrict n,
                                 const u32 (&__restrict opaque)[kBatch],
                                 const Paths& __restrict paths, Vertices& __restrict v) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 normal = v.normal.at(k), wo = -paths.direction.at(k);
    const bool behind = v.front[k] == 0;
    Frame f = frame_around(kBent ? bent_normal(n.at(k), normal, wo) : n.at(k));
    const float side = (behind & (opaque[k] != 0)) ? -1.0f : 1.0f;
    f.y *= side;
    f.z *= side;
    v.frame.set(k, f);
    v.local_wo.set(k, to_local(f, wo));
  }
}

// As lights see the surfaces.
PH_APART inline void find_receivers(const u32 (&__restrict opaque)[kBatch],
                                    Vertices& __restrict v) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 facing = v.normal.at(k) * (v.front[k] == 0 ? -1.0f : 1.0f), none = {0, 0, 0};
    v.receiver.set(k, Receiver{v.point.at(k), select(opaque[k] != 0, facing, none)});
  }
}

inline constexpr float kLeastGloss = 0.0625f;  // less is not worth the while

// Asks for light where a surface that the path has met mirrors it.
template <HasGloss Form>
PH_INLINE void turn_to_gloss(u32 k, Vertices& v) {
  const Form form = v.plain.at<Form>(k);
  const Vec3 wo = v.local_wo.at(k);
  Gloss g;
  if constexpr (NeedsTables<Form>) {
    g = gloss(form, v.from.at<typename Form::From>(k), wo);
  } else {
    g = gloss(form, wo);
  }
  if (!(g.share > kLeastGloss)) return;
  v.glossy |= 1u << k;
  v.highlight.set(k, Highlight{to_world(v.frame.at(k), {-wo.x, -wo.y, wo.z}), g.share,
                               1.0f / (g.alpha * g.alpha)});
}

// From which side of the surface, and with which parameters and frame, paths see their materials.
// Returns the lanes of those that scatter; rough: those of them that are no mere mirrors, where
// that is asked for. alike: those that shall choose lights as if nobody in particular looked at
// them.
template <class Watch>
inline u32 approach(const SceneView& scene, Wave& wave, Vertices& v, u32 lanes, u32 alike,
                    Kinds& kinds, u32& rough, const Watch& watch) {
  Paths& p = wave.paths;
  const bool tells = asks_for_light(scene) || wave.groups;
  Rows<Vec3, kBatch> n = v.shading;
  Vec3 along[kBatch];
  u32 opaque[kBatch], kind[kBatch], scattering = 0;
  for (u32 k = 0; k < kBatch; ++k) kind[k] = v.traits[k] >> kKindShift;
  for (u32 left = lanes; left != 0;) {
    const u32 one = kind[lowest_bit(left)], same = equal(one, kind) & left;
    kinds.lanes[one] = same;
    left &= ~same;
  }
  const u32 turned = having(kUsesUv, v.traits, lanes);
  for_each_bit(turned, [&](u32 k) {
    const MappedNormal mapped =
        mapped_normal(scene, *v.record[k], v.surface(k, p.slot.at(k)), p.width[k], v.mapped[k]);
    n.set(k, mapped.normal);
    v.shading.set(k, mapped.normal);
    along[k] = mapped.along;
  });
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    if (kTransmits<Material>) kinds.transmitting |= own;
  });
  spread(~kinds.transmitting, opaque);
  if (v.glossy != 0) v.highlight = {};
  v.glossy = 0;
  with_flag(find_bent(n, lanes, p, v) != 0,
            [&]<bool kBent>() { find_frames<kBent>(n, opaque, p, v); });
  if (asks_for_light(scene)) find_receivers(opaque, v);
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
        wave.features[k].albedo = albedo_of(v.parameters<Material>(k));
        wave.features[k].shading_normal = v.frame.at(k).z * (behind ? -1.0f : 1.0f);
      }
      const Fate fate = enter_material<Material>(scene, p, v, k);
      watch(Step::approaches, wave, &v, k, fate);
      if (fate == Fate::ends) wave.alive &= ~(1u << k);
      if (fate != Fate::scatters) return;
      scattering |= 1u << k;
      Material material = v.parameters<Material>(k);
      pull_to_mirror(scene, p.depth[k], material);
      if (tells && !is_delta(material)) rough |= 1u << k;
      bool is_plain = false;
      for_each_plain_form<Material>([&]<class Form>(u32 number) {
        if (is_plain || !Form::fits(material)) return;
        is_plain = true;
        kinds.plain[number] |= 1u << k;
        v.plain.set(k, Form::of(material));
      });
      if constexpr (Prepares<Material>) {
        if (!is_plain) v.prepared[k].set(prepare(material, v.local_wo.at(k)));
      }
    });
    for_each_plain_form<Material>([&]<class Form>(u32 number) {
      const u32 plain = own & kinds.plain[number];
      if (plain == 0) return;
      if constexpr (LooksFrom<Form>) look_up_from<Form>(plain, v);
      if constexpr (HasGloss<Form>) {
        if (chooses_lights(scene)) {
          for_each_bit(plain & ~alike, [&](u32 k) { turn_to_gloss<Form>(k, v); });
        }
      }
    });
  });
  for (u32& own : kinds.lanes) own &= scattering;
  return scattering;
}

}  // namespace parhelion::PH_ISA
