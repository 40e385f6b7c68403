// Where paths go on.
#pragma once
#include "draws.h"

namespace parhelion::PH_ISA {

// What materials have sampled, by lane: as BsdfSample, and whether there is one.
struct Sampled {
  Rows<Vec3, kBatch> wi, weight;
  float pdf[kBatch], eta[kBatch];
  u32 delta[kBatch], is[kBatch];

  PH_INLINE void set(u32 k, const BsdfSample& s, bool there) {
    wi.set(k, s.wi);
    weight.set(k, s.weight);
    pdf[k] = s.pdf;
    eta[k] = s.eta;
    delta[k] = s.delta ? 1u : 0u;
    is[k] = there ? 1u : 0u;
  }
};

// Which lobes scatter of forms that have two.
struct PickedLobes {
  u32 first[kBatch], upper[kBatch];
  float number[2][kBatch], lobe[kBatch];

  PH_INLINE PickedLobe at(u32 k) const {
    return {first[k] != 0, {number[0][k], number[1][k]}, upper[k] != 0, lobe[k]};
  }
};

template <class Form>
concept HasTwoLobes = NeedsTables<Form> || requires(const Form& m, Vec3 wo) { lobes(m, wo); };

template <class Form>
concept HasUpperLobe =
    NeedsTables<Form> &&
    requires(const Form& m, const typename Form::From& seen) { upper_part(m, seen); };

// In loops of their own: compilers would make branches of it in those that use what was picked.
template <class Form>
PH_APART inline void pick_lobes(const Vertices& __restrict v, const BounceDraws& __restrict draws,
                                PickedLobes& __restrict picked) {
  float first[kBatch], if_first[kBatch], if_other[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    LobeChances chances;
    if constexpr (NeedsTables<Form>) {
      chances = lobes(v.plain.at<Form>(k), v.from.at<typename Form::From>(k));
    } else {
      chances = lobes(v.plain.at<Form>(k), v.local_wo.at(k));
    }
    const float u = draws.direction[0][k];
    first[k] = chances.first;
    if_first[k] = left_of_first(chances.first, u);
    if_other[k] = left_of_other(chances.first, chances.other, u);
    picked.number[1][k] = draws.direction[1][k];
  }
  for (u32 k = 0; k < kBatch; ++k) {
    const bool is = draws.direction[0][k] < first[k];
    picked.first[k] = is ? 1u : 0u;
    picked.upper[k] = 0;
    picked.lobe[k] = draws.lobe[k];
    picked.number[0][k] = is ? if_first[k] : if_other[k];
  }
}

// Of those that have picked the first, which is two.
template <class Form>
PH_APART inline void pick_uppers(const Vertices& __restrict v, PickedLobes& __restrict picked) {
  float part[kBatch], if_upper[kBatch], if_lower[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const float u = picked.number[0][k];
    part[k] = upper_part(v.plain.at<Form>(k), v.from.at<typename Form::From>(k));
    if_upper[k] = left_of_first(part[k], u);
    if_lower[k] = left_of_other(part[k], 1.0f - part[k], u);
  }
  for (u32 k = 0; k < kBatch; ++k) {
    const float u = picked.number[0][k];
    const bool first = picked.first[k] != 0, is = u < part[k];
    picked.upper[k] = (first & is) ? 1u : 0u;
    picked.number[0][k] = first ? (is ? if_upper[k] : if_lower[k]) : u;
  }
}

template <class Form>
PH_APART inline void choose_plain(const Vertices& __restrict v,
                                  const PickedLobes& __restrict picked, Sampled& __restrict all) {
  for (u32 k = 0; k < kBatch; ++k) {
    Vec3 wi;
    const bool there = choose(v.plain.at<Form>(k), picked.at(k), v.local_wo.at(k), wi);
    all.wi.set(k, wi);
    all.is[k] = there ? 1u : 0u;
  }
}

template <class Form>
PH_APART inline void weigh_plain(const Vertices& __restrict v,
                                 const Rows<TableBlock, kBatch>& __restrict to,
                                 Sampled& __restrict all) {
  for (u32 k = 0; k < kBatch; ++k) {
    BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    const bool there = weigh_sample(v.plain.at<Form>(k), v.from.at<typename Form::From>(k),
                                    to.at<typename Form::To>(k), v.local_wo.at(k), all.wi.at(k), s);
    const u32 found = all.is[k];
    all.set(k, s, there);
    all.is[k] &= found;
  }
}

template <class Form>
PH_APART inline void sample_plain(const Vertices& __restrict v, const BounceDraws& __restrict draws,
                                  Sampled& __restrict all) {
  for (u32 k = 0; k < kBatch; ++k) {
    const auto material = whole_of<Form>(v, k);
    BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    const bool there = sample(material, v.local_wo.at(k), draws.bsdf(k), s);
    all.set(k, s, there);
  }
}

template <class Form>
PH_APART inline void sample_picked(const Vertices& __restrict v,
                                   const PickedLobes& __restrict picked, Sampled& __restrict all) {
  for (u32 k = 0; k < kBatch; ++k) {
    BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    const bool there = sample(v.plain.at<Form>(k), v.local_wo.at(k), picked.at(k), s);
    all.set(k, s, there);
  }
}

// Puts those that `these` says among the others: in a loop of its own, so that compilers do not
// move the ones before into its branches.
PH_APART inline void keep_these(const u32 (&__restrict these)[kBatch],
                                const Sampled& __restrict all, Sampled& __restrict next) {
  for (u32 k = 0; k < kBatch; ++k) {
    const bool own = these[k] != 0;
    next.wi.set(k, select(own, all.wi.at(k), next.wi.at(k)));
    next.weight.set(k, select(own, all.weight.at(k), next.weight.at(k)));
    next.pdf[k] = own ? all.pdf[k] : next.pdf[k];
    next.eta[k] = own ? all.eta[k] : next.eta[k];
    next.delta[k] = own ? all.delta[k] : next.delta[k];
    next.is[k] = own ? all.is[k] : next.is[k];
  }
}

// Sends on the paths that `these` says, and says of which that is the end. kOthers: others go on
// from where they are; without, whatever is not sent on has ended, and its ray may be written over.
// What it carries stays, as whoever watches asks why it has ended.
template <bool kOthers>
PH_APART inline void send_on(const u32 (&__restrict these)[kBatch], const Sampled& __restrict next,
                             const BounceDraws& __restrict draws, const Vertices& __restrict v,
                             u32 unasked, u32 roulette_from, u32 (&__restrict goes)[kBatch],
                             Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 direction = p.direction.at(k), normal = v.normal.at(k), point = v.point.at(k);
    const Vec3 local_wo = v.local_wo.at(k), local_wi = next.wi.at(k);
    const bool delta = next.delta[k] != 0;
    const float pdf = next.pdf[k];
    const Vec3 wi = renormalize(to_world(v.frame.at(k), local_wi));
    const bool fits = (these[k] != 0) & (next.is[k] != 0) &
                      consistent(normal, -direction, wi, local_wo, local_wi);
    const Vec3 before = p.throughput.at(k), throughput = before * next.weight.at(k);
    const float eta_scale = p.eta_scale[k] * (next.eta[k] * next.eta[k]);
    // The cone of directions that are as likely as one sample in sixty-four.
    const float wide = max(p.spread[k], 0.125f / sqrt(max(pdf, 1e-6f)));

    // Russian roulette
    const float carried = max_component(throughput) * eta_scale;
    const float survival = carried * (1.0f / kRouletteBelow);
    const bool plays = (p.depth[k] >= roulette_from) & (survival < 0.95f);
    const float chance = plays ? survival : 1.0f;
    // By the difference: compilers would make branches of a comparison.
    const bool on = fits & !(survival <= 0.0f) & (chance - draws.roulette[k] > 0.0f);
    const Vec3 kept = throughput * (1.0f / chance);

    const bool behind = dot(wi, normal) < 0.0f, moved = on | !kOthers;
    p.origin.set(k, select(moved, ray_origin(point, normal, v.error[k], behind), p.origin.at(k)));
    p.direction.set(k, select(moved, wi, direction));
    p.self.leaf[k] = moved ? p.slot.leaf[k] : p.self.leaf[k];
    p.self.lane[k] = moved ? p.slot.lane[k] : p.self.lane[k];
    p.self.instance[k] = moved ? p.slot.instance[k] : p.self.instance[k];
    p.inward[k] = moved ? (behind ? 1u : 0u) ^ v.inside_out[k] : p.inward[k];
    p.scatter_pdf[k] = moved ? ((next.delta[k] | unasked) != 0 ? 0.0f : pdf) : p.scatter_pdf[k];
    p.throughput.set(k, select(on, kept, select(fits, throughput, before)));
    p.eta_scale[k] = fits ? eta_scale : p.eta_scale[k];
    p.spread[k] = (fits & !delta) ? wide : p.spread[k];
    p.depth[k] += on ? 1u : 0u;
    goes[k] = on ? 1 : 0;
  }
}

// Remembers of paths that go on which surface they come from: lights ask for it.
PH_APART inline void leave_receivers(const u32 (&__restrict goes)[kBatch],
                                     const Vertices& __restrict v, Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Receiver to = v.receiver.at(k), from = p.receiver.at(k);
    const bool on = goes[k] != 0;
    p.receiver.set(k,
                   Receiver{select(on, to.point, from.point), select(on, to.normal, from.normal)});
  }
}

// Scatters the paths of `lanes`, beside which others may go on; returns those of them that do, and
// in `mirrored` those that no density tells the way of.
inline u32 scatter(const SceneView& scene, const RenderView& view, const Kinds& kinds, u32 lanes,
                   u32 others, const BounceDraws& draws, const Vertices& v, Paths& p,
                   u32& mirrored) {
  Sampled next = {};
  bool some = false;  // are there
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    plain_and_others<Material>(
        kinds, own,
        [&]<class Form>(u32 plain, const auto& these) {
          // The first may write to all lanes.
          Sampled apart;
          Sampled& all = some ? apart : next;
          PickedLobes picked;
          if constexpr (HasTwoLobes<Form>) pick_lobes<Form>(v, draws, picked);
          if constexpr (HasUpperLobe<Form>) pick_uppers<Form>(v, picked);
          if constexpr (NeedsTables<Form>) {
            Rows<TableBlock, kBatch> tables = {};
            choose_plain<Form>(v, picked, all);
            look_up<Form>(plain, v, all.wi, tables);
            weigh_plain<Form>(v, tables, all);
          } else if constexpr (HasTwoLobes<Form>) {
            sample_picked<Form>(v, picked, all);
          } else {
            sample_plain<Form>(v, draws, all);
          }
          if (some) keep_these(these, apart, next);
          some = true;
        },
        [&](u32 k) {
          BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
          Material material = v.parameters<Material>(k);
          pull_to_mirror(scene, p.depth[k], material);
          const Vec3 wo = v.local_wo.at(k);
          const BsdfDraws u = draws.bsdf(k);
          bool there;
          if constexpr (Prepares<Material>) {
            const auto& seen = v.prepared[k].template as<decltype(prepare(material, wo))>();
            there = sample(material, seen, wo, u, s);
          } else {
            there = sample(material, wo, u, s);
          }
          next.set(k, s, there);
          some = true;
        });
  });
  u32 these[kBatch], goes[kBatch];
  spread(lanes, these);
  const bool lit = asks_for_light(scene);
  with_flag(others != 0, [&]<bool kOthers>() {
    send_on<kOthers>(these, next, draws, v, lit ? 0 : 1, view.roulette ? kRouletteStart : kNone,
                     goes, p);
  });
  if (lit) leave_receivers(goes, v, p);
  const u32 on = having(1, goes, lanes);
  mirrored = having(1, next.delta, on);
  if ((v.glossy | p.glossy) != 0) {
    for_each_bit(on, [&](u32 k) { p.set_highlight(k, v.glossy >> k & 1u, v.highlight, k); });
  }
  for_each_bit(kinds.transmitting & on, [&](u32 k) {
    if (next.wi.at(k).z * v.local_wo.at(k).z < 0.0f) {
      cross_boundary(scene, p.media[k], *v.record[k], v.front[k] != 0);
    }
  });
  return on;
}

}  // namespace parhelion::PH_ISA
