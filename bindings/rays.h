// Rays against a scene: ../host/rays.h.
#pragma once
#include <nanobind/nanobind.h>

#include "../host/scene.h"

namespace parhelion {

// Adds methods to the class, too.
void bind_rays(nanobind::module_& m, nanobind::class_<Scene>& scene);

}  // namespace parhelion
