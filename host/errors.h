// What the host throws; the bindings turn it into the Python error of the same name.
#pragma once
#include <stdexcept>
#include <string>

namespace parhelion {

struct SceneError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

struct ResourceError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace parhelion
