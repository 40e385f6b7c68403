// All lights that are no shapes behind one switch, made from lights.def.
#pragma once
#include "lights/constant.h"
#include "lights/directional.h"
#include "lights/envmap.h"
#include "lights/goniometric.h"
#include "lights/gradient.h"
#include "lights/point.h"
#include "lights/projector.h"
#include "lights/sky.h"
#include "lights/spot.h"
#include "lights/sun.h"

namespace parhelion {

enum class LightKind : u32 {
#define LIGHT(name, Type) name,
#include "lights.def"
#undef LIGHT
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Calls f with the struct of the record's own light.
template <class F>
PH_INLINE auto with_light(const ParamBlock& block, F&& f) {
  switch (static_cast<LightKind>(block.kind)) {
#define LIGHT(name, Type) \
  case LightKind::name: return f(from_block<Type>(block));
#include "lights.def"
#undef LIGHT
  }
  compiler::unreachable();
}

PH_INLINE bool is_panorama(const LightRecord& record) {
  return static_cast<LightKind>(record.block.kind) == LightKind::envmap;
}

// Whether it shines from infinitely far away.
PH_INLINE bool is_outside(const LightRecord& record) {
  return with_light(record.block, []<class Light>(const Light&) { return Light::outside; });
}

// Whether scattering alone is to find it.
PH_INLINE bool is_smooth(const LightRecord& record) {
  return with_light(record.block, []<class Light>(const Light&) {
    if constexpr (requires { Light::smooth; }) {
      return Light::smooth;
    } else {
      return false;
    }
  });
}

PH_INLINE LightSample sample_light(const LightRecord& record, const LightTables& tables, Vec3 from,
                                   Vec2 u) {
  return with_light(record.block,
                    [&](const auto& light) { return sample(light, record, tables, from, u); });
}

// What a ray that leaves the scene in a direction sees of a light.
PH_INLINE Vec3 light_radiance(const LightRecord& record, const LightTables& tables,
                              Vec3 direction) {
  return with_light(record.block,
                    [&](const auto& light) { return radiance(light, record, tables, direction); });
}

// That, and the density with which sample_light finds the direction.
PH_INLINE LightSight light_seen(const LightRecord& record, const LightTables& tables,
                                Vec3 direction) {
  return with_light(record.block, [&](const auto& light) -> LightSight {
    if constexpr (requires { seen(light, record, tables, direction); }) {
      return seen(light, record, tables, direction);
    } else {
      return {radiance(light, record, tables, direction), pdf(light, record, tables, direction)};
    }
  });
}

// Of lights that are not outside.
PH_INLINE LightReach light_reach(const LightRecord& record, const LightTables& tables) {
  return with_light(record.block, [&]<class Light>(const Light& light) -> LightReach {
    if constexpr (Light::outside) {
      return {};
    } else {
      return reach(light, record, tables);
    }
  });
}

}  // namespace parhelion::PH_ISA
