// All lights from outside the scene behind one switch, made from lights.def.
#pragma once
#include "lights/constant.h"
#include "lights/gradient.h"

namespace parhelion {

enum class LightKind : u32 {
#define LIGHT(name, Type) name,
#include "lights.def"
#undef LIGHT
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Radiance that arrives from a direction.
PH_INLINE Vec3 light_radiance(const ParamBlock& block, Vec3 direction) {
  switch (static_cast<LightKind>(block.kind)) {
#define LIGHT(name, Type) \
  case LightKind::name: return radiance(from_block<Type>(block), direction);
#include "lights.def"
#undef LIGHT
  }
  compiler::unreachable();
}

}  // namespace parhelion::PH_ISA
