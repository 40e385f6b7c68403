// The one place where every number of the user's shapes is looked at.
#pragma once
#include <string>
#include <vector>

#include "scene.h"

namespace parhelion {

// All throw SceneError, naming shape and element.
class SceneChecks {
 public:
  explicit SceneChecks(const std::vector<MaterialRecord>& materials);

  // Of a shape that is no instance: the largest |coordinate| plus radius.
  double extent(const ShapeInput& shape) const;
  // Spheres so small beside a scene of that extent that their squared radius would be lost.
  void sizes(const ShapeInput& shape, double extent) const;
  // Of instances: that matrices can be inverted and the group is one of `groups`.
  void instances(const ShapeInput& shape, u32 groups) const;

 private:
  // The values that a primitive's own colour may have: those of its material's first parameter.
  struct ColorRange {
    float low, high;
    const char* material;
  };
  std::vector<ColorRange> colors_;
};

// A material's or light's parameters, as their tables say.
struct ParamSpan {
  const ParamInfo* first;
  size_t count;
};
ParamSpan material_params(u32 kind);
ParamSpan light_params(u32 kind);

// Multiplies what the table says are lengths.
void scale_lengths(ParamBlock& block, ParamSpan params, double scale);

}  // namespace parhelion
