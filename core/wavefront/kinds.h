// The types of materials that sixteen paths have met.
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

// Of the lanes at materials of one type: calls together(these) once for those that are plain, with
// 1 for each, and alone(k) for each of the others.
template <class Material, class Together, class Alone>
PH_INLINE void plain_and_others(const Kinds& kinds, u32 lanes, Together&& together, Alone&& alone) {
  if constexpr (requires { typename Material::Plain; }) {
    if ((lanes & kinds.plain) != 0) {
      u32 these[kBatch];
      spread(lanes & kinds.plain, these);
      together(these);
      lanes &= ~kinds.plain;
    }
  }
  for_each_bit(lanes, alone);
}

}  // namespace parhelion::PH_ISA
