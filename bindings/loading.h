// What reads and prepares files where NumPy is slow: ../loading.
#pragma once
#include <nanobind/nanobind.h>

namespace parhelion {

void bind_loading(nanobind::module_& m);

}  // namespace parhelion
