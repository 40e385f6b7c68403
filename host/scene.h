// The scene as the host owns it: checked, normalised, with its tree and its table of lights.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "../core/path.h"

namespace parhelion {

// N spheres in the user's arrays and units; nothing is kept of them after the scene is made.
struct SphereGroup {
  std::string name;
  size_t count = 0;
  const void* centers = nullptr;  // (count, 3), float or double
  bool centers_double = false;
  const void* radii = nullptr;  // (count), or one for all
  bool radii_double = false;
  bool one_radius = false;
  const u32* material_of = nullptr;  // (count), or null: all have `material`
  u32 material = 0;
  const float* colors = nullptr;  // (count, 3), or null: the material's own
};

class Scene {
 public:
  // Throws SceneError, naming group and element, for a number that has no meaning.
  Scene(const std::vector<SphereGroup>& groups, std::vector<ParamBlock> materials,
        const ParamBlock& background);
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  const SceneView& view() const { return view_; }
  // Normalised units per user's unit: a power of two.
  double scale() const { return scale_; }
  size_t sphere_count() const { return sphere_count_; }
  size_t node_count() const { return nodes_.size(); }
  size_t block_count() const { return spheres_.size(); }
  size_t emitter_count() const { return emitters_.size(); }
  // Bytes held by the scene.
  size_t memory() const;

 private:
  void make_emitters();

  size_t sphere_count_ = 0;
  double scale_ = 1.0;
  std::vector<Node> nodes_;
  std::vector<SphereBlock> spheres_;
  std::vector<ParamBlock> materials_;
  std::vector<u32> material_of_;
  std::vector<Vec3> color_of_;
  std::vector<Emitter> emitters_;
  SceneView view_{};
};

}  // namespace parhelion
