// Blends: a path goes on by one of the two materials, as chance will have it, but light is asked
// for both. What either scatters of it, by its share, is weighed against the density of its own of
// going there: light that paths meet by themselves is weighed so, too, so each is counted once.
#pragma once
#include "lights.h"
#include "materials.h"
#include "textures.h"

namespace parhelion::PH_ISA {

// The materials that paths go on by, of blends.
PH_APART inline void choose_materials(const SceneView& scene, u32 lanes, Paths& p, Vertices& v) {
  float number[kBatch];
  turn_to_bounce(p);
  draw1(p.samplers, kDrawBlend, number);
  for_each_bit(lanes, [&](u32 k) {
    const auto here = [&] { return v.surface(k, p.slot.at(k)); };
    const BlendChoice choice = choose_material(scene, *v.record[k], here, p.width[k], number[k]);
    v.record[k] = choice.own;
    v.traits[k] = choice.own->traits;
    v.set_blend(k, choice);
  });
}

// The materials that paths do not go on by, where light is asked for them, too.
struct Partners {
  u32 lanes = 0;
  bool begun = false;  // all of v has been written
  Kinds kinds;         // and what follows, where there are any lanes
  Vertices v;          // the surfaces as these materials make them
};

template <class Material>
PH_INLINE bool lets_light_through(const Material& m) {
  if constexpr (requires { is_opaque(m); }) return !is_opaque(m);
  return kTransmits<Material>;
}

// Whether light is asked for a material if the path goes on by the other one: not for mirrors, not
// where paths would have to keep account of bodies, and not of what sends colours apart, which few
// paths would ask for.
PH_INLINE bool asks_beside(const MaterialRecord& record, const ParamBlock& block) {
  return record.priority == 0 && with_material(block, [&](const auto& m) {
           if (is_delta(m) || (record.body && lets_light_through(m))) return false;
           if constexpr (requires { m.dispersion; }) return m.dispersion == 0.0f;
           return true;
         });
}

// Finds them for some lanes at blends, as `approach` does for those that paths go on by. Before it,
// while normals are those of the surface.
PH_APART inline void approach_partners(const SceneView& scene, Wave& wave, u32 lanes,
                                       const Vertices& v, Partners& others) {
  if (others.begun) {
    static_cast<MetSurfaces&>(others.v) = v;
  } else {
    others.v = v;
    others.begun = true;
  }
  others.kinds = {};
  for_each_bit(lanes, [&](u32 k) {
    others.v.record[k] = v.other[k];
    others.v.traits[k] = v.other[k]->traits;
  });
  find_parameters(scene, wave.paths, lanes, others.v);
  for_each_bit(lanes, [&](u32 k) {
    const Vertices& o = others.v;
    const bool both =
        asks_beside(*v.record[k], *v.block[k]) && asks_beside(*o.record[k], *o.block[k]);
    others.lanes |= (both ? 1u : 0u) << k;
  });
  u32 rough = 0;
  approach(scene, wave, others.v, others.lanes, 0, others.kinds, rough, Unwatched{});
}

// Lets both materials of a blend choose the same lights: whichever the path goes on by, what it
// meets is weighed by the same chance of having been asked.
PH_APART inline void see_alike(const Partners& others, const Kinds& kinds, Vertices& v) {
  const u32 transmitting = kinds.transmitting | others.kinds.transmitting;
  for_each_bit(others.lanes, [&](u32 k) {
    if ((transmitting >> k & 1u) != 0) {
      v.receiver.set(k, Receiver{v.receiver.at(k).point, {0, 0, 0}});
    }
    Highlight own = v.highlight.at(k), other = others.v.highlight.at(k);
    own.gloss *= v.share[k];
    other.gloss *= 1.0f - v.share[k];
    const bool second = (v.second >> k & 1u) != 0;
    const bool is_own = second ? own.gloss > other.gloss : own.gloss >= other.gloss;
    const Highlight most = is_own ? own : other;
    v.highlight.set(k, most);
    v.glossy = (v.glossy & ~(1u << k)) | (most.gloss > 0.0f ? 1u : 0u) << k;
  });
}

// As `weigh` does, and adds what partners scatter of the light.
inline u32 weigh_both(const Paths& paths, const Kinds& kinds, u32 lanes, u32 shared,
                      Partners& others, Vertices& v) {
  const u32 own = weigh(paths, kinds, lanes, shared, v);
  if ((lanes & others.lanes) == 0) return own;
  Vertices& o = others.v;
  o.to_light = v.to_light;
  o.radiance = v.radiance;
  compiler::copy(o.light_pdf, v.light_pdf, sizeof(v.light_pdf));
  compiler::copy(o.light_delta, v.light_delta, sizeof(v.light_delta));
  const u32 theirs = weigh(paths, others.kinds, lanes & others.lanes, 0, o);
  for_each_bit((own | theirs) & others.lanes, [&](u32 k) {
    const auto part = [&](const Vertices& in, u32 lit, float share) {
      if ((lit >> k & 1u) == 0) return Vec3{0, 0, 0};
      const float density = in.light_pdf[k];
      const bool sampled = in.light_delta[k] == 0;
      const float weight =
          sampled ? power_heuristic(density, share * in.scattered.at(k).pdf) : 1.0f;
      return in.value.at(k) * (share * weight / density);
    };
    v.value.set(k, part(v, own, v.share[k]) + part(o, theirs, 1.0f - v.share[k]));
    v.scale[k] = 1.0f;
  });
  return own | theirs;
}

// Of paths that go on from such surfaces: how likely they were to go there by their material.
PH_INLINE void leave_blends(const Partners& others, const Vertices& v, u32 lanes, Paths& p) {
  for_each_bit(lanes & others.lanes, [&](u32 k) { p.scatter_pdf[k] *= v.share[k]; });
}

}  // namespace parhelion::PH_ISA
