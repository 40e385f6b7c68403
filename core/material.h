// All materials behind one switch, made from materials.def.
#pragma once
#include "bsdf.h"
#include "materials/conductor.h"
#include "materials/dielectric.h"
#include "materials/diffuse.h"
#include "materials/diffuse_transmission.h"
#include "materials/emissive.h"
#include "materials/metal.h"
#include "materials/null.h"
#include "materials/plastic.h"
#include "materials/principled.h"
#include "materials/thin_dielectric.h"

namespace parhelion {

enum class MaterialKind : u32 {
#define MATERIAL(name, Type) name,
#include "materials.def"
#undef MATERIAL
};
inline constexpr u32 kMaterialKinds = 0
#define MATERIAL(name, Type) +1
#include "materials.def"
#undef MATERIAL
    ;

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Calls f with the struct of the block's own material.
template <class F>
PH_INLINE auto with_material(const ParamBlock& block, F&& f) {
  switch (static_cast<MaterialKind>(block.kind)) {
#define MATERIAL(name, Type) \
  case MaterialKind::name: return f(from_block<Type>(block));
#include "materials.def"
#undef MATERIAL
  }
  compiler::unreachable();
}

// Whether a material takes a number of its own to choose a lobe.
template <class Material>
concept LobeDraws = requires { requires Material::lobe_draws; };

PH_INLINE Vec3 block_color(const ParamBlock& block) {
  return {block.value[0], block.value[1], block.value[2]};
}
// A primitive's own colour stands for the material's, its first parameter.
template <class Material>
PH_INLINE void set_first_color(Material& m, Vec3 color) {
  static_assert(Material::params[0].size == 3);
  compiler::copy(&m, &color, sizeof(color));
}

}  // namespace parhelion::PH_ISA
