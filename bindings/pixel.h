// One sample's path for people: ../host/trace_pixel.h.
#pragma once
#include <nanobind/nanobind.h>

namespace parhelion {

void bind_pixel(nanobind::module_& m);

}  // namespace parhelion
