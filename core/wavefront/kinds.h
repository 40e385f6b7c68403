// The types of materials that sixteen paths have met.
#pragma once
#include "wave.h"

namespace parhelion::PH_ISA {

// The paths, a bit for each, at surfaces of each type of material; and which of them are plain, in
// the first form of their type that fits, the second, ...
struct Kinds {
  u32 lanes[kMaterialKinds] = {};
  u32 plain[kMostPlainForms] = {}, transmitting = 0;
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

// Of the lanes at materials of one type: calls together.operator()<Form>(these) once for those of
// each plain form, also as bits, with 1 for each, and alone(k) for each of the others.
template <class Material, class Together, class Alone>
PH_INLINE void plain_and_others(const Kinds& kinds, u32 lanes, Together&& together, Alone&& alone) {
  u32 others = lanes;
  for_each_plain_form<Material>([&]<class Form>(u32 number) {
    const u32 plain = lanes & kinds.plain[number];
    if (plain == 0) return;
    u32 these[kBatch];
    spread(plain, these);
    together.template operator()<Form>(plain, these);
    others &= ~plain;
  });
  for_each_bit(others, alone);
}

// What tables have of directions, for plain forms that need them: of local_wo,
template <LooksFrom Form>
PH_APART inline void find_places_from(const PlainSurfaces& __restrict v,
                                      Rows<typename Form::FromPlace, kBatch>& __restrict places) {
  for (u32 k = 0; k < kBatch; ++k) {
    places.set(k, place_from(v.plain.at<Form>(k), v.local_wo.at(k)));
  }
}
template <LooksThroughLayers Form>
PH_APART inline void find_layer_places(const PlainSurfaces& __restrict v,
                                       Rows<typename Form::LayerPlace, kBatch>& __restrict places) {
  for (u32 k = 0; k < kBatch; ++k) {
    places.set(k, layer_place_from(v.plain.at<Form>(k), v.local_wo.at(k)));
  }
}
template <LooksFrom Form>
inline void look_up_from(u32 lanes, PlainSurfaces& v) {
  Rows<typename Form::FromPlace, kBatch> places;
  find_places_from<Form>(v, places);
  if constexpr (LooksThroughLayers<Form>) {
    Rows<typename Form::LayerPlace, kBatch> layers;
    find_layer_places<Form>(v, layers);
    for_each_bit(lanes, [&](u32 k) {
      v.from.set(k, from(v.plain.at<Form>(k), places.at(k), layers.at(k)));
    });
  } else {
    for_each_bit(lanes, [&](u32 k) { v.from.set(k, from(v.plain.at<Form>(k), places.at(k))); });
  }
}

// and of others.
template <NeedsTables Form>
PH_APART inline void find_places_to(const PlainSurfaces& __restrict v,
                                    const Rows<Vec3, kBatch>& __restrict wi,
                                    Rows<typename Form::ToPlace, kBatch>& __restrict places) {
  for (u32 k = 0; k < kBatch; ++k) places.set(k, place_to(v.plain.at<Form>(k), wi.at(k)));
}
template <NeedsTables Form>
inline void look_up(u32 lanes, const PlainSurfaces& v, const Rows<Vec3, kBatch>& wi,
                    Rows<TableBlock, kBatch>& tables) {
  if (lanes == 0) return;
  Rows<typename Form::ToPlace, kBatch> places;
  find_places_to<Form>(v, wi, places);
  for_each_bit(lanes, [&](u32 k) { tables.set(k, to(v.plain.at<Form>(k), places.at(k))); });
}

// What samples and evaluates the plain form of a surface.
template <class Form>
PH_INLINE auto whole_of(const PlainSurfaces& v, u32 k) {
  if constexpr (LooksFrom<Form>) {
    return v.plain.at<Form>(k).whole(v.from.at<typename Form::From>(k));
  } else {
    return v.plain.at<Form>(k).whole();
  }
}

// What surfaces of one plain form scatter from wo towards wi.
template <class Form>
PH_APART inline void value_of_plain(const u32 (&__restrict these)[kBatch],
                                    const Rows<TableBlock, kBatch>& __restrict to,
                                    PlainSurfaces& __restrict v) {
  // In a loop of its own, so that compilers do not move it into branches of the next.
  Rows<BsdfValue, kBatch> all;
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 wo = v.local_wo.at(k), wi = v.local_wi.at(k);
    if constexpr (NeedsTables<Form>) {
      const Form form = v.plain.at<Form>(k);
      all.set(k, evaluate(form, v.from.at<typename Form::From>(k), to.at<typename Form::To>(k), wo,
                          wi));
    } else {
      all.set(k, value_of(whole_of<Form>(v, k), wo, wi));
    }
  }
  for (u32 k = 0; k < kBatch; ++k) {
    const bool own = these[k] != 0;
    const BsdfValue f = all.at(k), before = v.scattered.at(k);
    v.scattered.set(k, BsdfValue{select(own, f.value, before.value), own ? f.pdf : before.pdf});
  }
}

}  // namespace parhelion::PH_ISA
