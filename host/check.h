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
  // That a shape, found sound, has or its primitives have; each once.
  std::vector<u32> materials(const ShapeInput& shape) const;
  // The colours that all of a group's materials may have.
  ColorRange colors(const GroupInput& shapes) const;
  // Of instances: that matrices can be inverted and colours are in range, one for each group.
  void instances(const ShapeInput& shape, const std::vector<ColorRange>& groups) const;

 private:
  std::vector<ColorRange> colors_;  // of each material
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
