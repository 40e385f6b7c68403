// The scene as the host owns it: checked, normalised, with its tree and its lights.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "../core/path.h"
#include "array.h"
#include "distribution.h"
#include "image.h"
#include "light_tree.h"
#include "memory.h"

namespace parhelion {

// Rows of numbers of the user's, float or double; `one` stands for all rows alike.
struct Numbers {
  const char* name = "";
  const void* data = nullptr;
  bool is_double = false, one = false;
  int columns = 1;

  const void* row(size_t i) const {
    const size_t size = static_cast<size_t>(columns) * (is_double ? sizeof(double) : sizeof(float));
    return static_cast<const char*>(data) + (one ? 0 : i * size);
  }
  double at(size_t row, int column) const {
    const size_t i = (one ? 0 : row) * static_cast<size_t>(columns) + static_cast<size_t>(column);
    return is_double ? static_cast<const double*>(data)[i]
                     : static_cast<double>(static_cast<const float*>(data)[i]);
  }
};

struct AttributeInput {
  u32 name;
  const float* values;
  size_t rows;
  u32 components;
  bool per_face;
};

// One shape in the user's arrays and units; nothing is kept of them after the scene is made.
struct ShapeInput {
  ShapeKind kind = ShapeKind::sphere;
  std::string name;
  size_t count = 0;             // primitives
  std::vector<Numbers> arrays;  // in the order that host/shapes.h says for each kind
  u32 material = 0;
  const u32* material_of = nullptr;  // (count), or null: all have `material`
  const float* colors = nullptr;     // (count, 3), or null: the material's own
  bool inside_out = false;
  float rotation[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};  // spheres

  // Triangles: three vertices each, of vertex_count, and what is known of those.
  const u32* faces = nullptr;
  size_t vertex_count = 0;
  const float* normals = nullptr;
  const float* uvs = nullptr;
  const float* tangents = nullptr;  // four numbers each
  std::vector<AttributeInput> attributes;

  // Instances: of a group, by (count, 12) affine matrices; colours for what has none of its own.
  u32 group = 0;
  const double* transforms = nullptr;
};

// The values that a primitive's own colour may have: those of its material's first parameter.
struct ColorRange {
  float low, high;
  const char* material;
};

// The shapes of each group; the last group is the scene itself, the only one with instances.
using GroupInput = std::vector<ShapeInput>;

// Lights, materials and textures with lengths still in the user's units.
struct LightInput {
  std::string name;
  LightRecord record;
};

struct SceneInput {
  std::vector<GroupInput> groups;
  std::vector<MaterialRecord> materials;
  std::vector<TextureBinding> bindings;
  std::vector<TextureRecord> textures;
  std::vector<ImageInput> images;
  std::vector<LightInput> lights;
};

class Scene {
 public:
  // Throws SceneError, naming shape and element, for a number that has no meaning, and
  // ResourceError for what would take more bytes than memory_limit beside the input.
  explicit Scene(SceneInput input, u64 memory_limit = ~u64{0});
  ~Scene();
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  // Other numbers for all materials, or lights, of the same kinds, with the same textures and
  // images, in the same order; the trees of shapes stay. Not while a picture is made of the scene.
  // Throws SceneError, and changes nothing, if a material would begin to shine: which primitives do
  // is found when their trees are built.
  void set_materials(std::vector<MaterialRecord> materials);
  void set_lights(std::vector<LightInput> lights);

  const SceneView& view() const { return view_; }
  // Normalised units per user's unit: a power of two.
  double scale() const { return scale_; }
  // Whether there is glass or liquid that a path keeps account of being inside of.
  bool has_bodies() const { return view_.has_bodies; }
  size_t primitive_count() const { return primitive_count_; }
  size_t primitive_count(ShapeKind kind) const { return count_of_[static_cast<u32>(kind)]; }
  size_t node_count() const { return nodes_.size(); }
  size_t block_count() const;
  // Lights that are asked for: emissive primitives, and those that are no shapes.
  size_t light_count() const { return light_count_; }
  // What the user calls view().lights.
  const std::vector<std::string>& light_names() const { return light_names_; }
  // Bytes held by the scene.
  size_t memory() const;
  // The most that were held at a time while it was made, as it was expected.
  size_t peak_memory() const { return memory_plan_.peak(); }

 private:
  // What is kept of a mesh for its surface.
  struct MeshData {
    Array<u32> faces;
    Array<Vec3> normals;
    Array<Vec2> uvs;
    Array<Tangent> tangents;
    std::vector<MeshAttribute> attributes;
    std::vector<Array<float>> values;
  };
  struct PlannedTree;
  // A group in units of its own.
  struct BuiltGroup {
    double scale;
    Box bounds;
    std::vector<Slot> emitters;         // in the order of its shapes' first_emitter
    ColorRange colors;                  // of its instances
    std::unique_ptr<PlannedTree> tree;  // until it is written
  };

  void add_group(const GroupInput& shapes, std::vector<BuiltGroup>& built, u32& next_id, bool own);
  void expect_input(const SceneInput& input);
  void expect_lights(const std::vector<LightInput>& lights, const std::vector<BuiltGroup>& built);
  void write_groups(std::vector<BuiltGroup>& built);
  void find_emitters(BuiltGroup& group, const Group& place) const;
  void keep_mesh(const ShapeInput& shape, ShapeRecord& record);
  void guide_shapes(u32 primitives);
  void make_materials();
  void find_all_emitters(const std::vector<BuiltGroup>& built);
  void make_lights(std::vector<LightInput> lights);
  void weigh_lights();
  void tabulate(LightRecord& record);
  LightLeaf leaf_of(const Slot& slot) const;
  void share_outside(const std::vector<LightLeaf>& leaves);
  double usual_distance(Vec3 from) const;
  bool shines(const MaterialRecord& m) const;

  MemoryPlan memory_plan_;
  u64 planning_ = 0;  // bytes of the group that took the most while its tree was planned
  size_t primitive_count_ = 0;
  size_t count_of_[8] = {};
  size_t light_count_ = 0;
  double scale_ = 1.0;
  Array<Node> nodes_;
#define SHAPE(name, Type) Array<Type##Block> name##s_;
#include "../core/shapes.def"
#undef SHAPE
  std::vector<Instance> instances_;
  std::vector<Group> groups_;
  std::vector<ShapeRecord> shapes_;
  std::vector<u32> shape_guide_;
  std::vector<std::unique_ptr<MeshData>> meshes_;
  std::vector<MaterialRecord> materials_;
  std::vector<TextureBinding> bindings_;
  std::vector<TextureRecord> textures_;
  std::vector<ImagePyramid> pyramids_;  // the user's, then those of lights
  size_t own_images_ = 0;
  std::vector<ImageView> images_;
  Array<u32> material_of_;
  Array<Vec3> color_of_;
  std::vector<Slot> emitters_;
  std::vector<LightRecord> lights_;
  std::vector<std::string> light_names_;
  LightTree light_tree_;
  std::vector<DistributionTable> distributions_;
  std::vector<Distribution> distribution_views_;
  SceneView view_{};
};

}  // namespace parhelion
