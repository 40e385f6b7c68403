#include "scene.h"

#include <omp.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>

#include "check.h"
#include "errors.h"
#include "shapes.h"
#include "sky.h"
#include "threads.h"
#include "wake_apart.h"

namespace parhelion {
namespace {

constexpr size_t kMaxPrimitives = 0xfffffff0u;  // ids are 32 bits, and ~0 is none
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// The primitives of a group, for the tree builder, which counts them from 0 on.
struct Leaves {
  const GroupInput& shapes;
  double scale;
  u32 first_id;                      // the first primitive's among those of the scene
  std::vector<u32> first;            // of each shape
  std::vector<u32> instances;        // of each shape that places some: its first among the scene's
  std::vector<Aabb> instance_boxes;  // of all of those, from the group's first on
  u32 first_instance;
#define SHAPE(name, Type) Type##Block* name##s = nullptr;  // the scene's
#include "../core/shapes.def"
#undef SHAPE

  // Shapes without primitives begin where their successor does.
  u32 shape_of(size_t i) const {
    if (first.size() == 1) return 0;
    const auto next = std::upper_bound(first.begin(), first.end(), static_cast<u32>(i));
    return static_cast<u32>(next - first.begin()) - 1;
  }
  ShapeKind kind(const Ref& r) const { return shapes[r.shape].kind; }
  u32 instance_of(u32 shape, size_t i) const {
    return instances[shape] + static_cast<u32>(i) - first[shape];
  }
  Child instance_leaf(const Ref& r) const {
    return make_leaf(ShapeKind::instance, instance_of(r.shape, r.id));
  }

  void prefetch(size_t i) const {
    const u32 shape = shape_of(i);
    const size_t row = i - first[shape];
    if (shapes[shape].faces) {
      __builtin_prefetch(shapes[shape].faces + 3 * row);
    } else {
      for (const Numbers& a : shapes[shape].arrays) __builtin_prefetch(a.row(row));
    }
  }
  void prefetch_vertices(size_t i) const {
    const u32 shape = shape_of(i);
    const u32* const faces = shapes[shape].faces;
    if (!faces) return;
    for (size_t k = 0; k < 3; ++k) {
      __builtin_prefetch(shapes[shape].arrays[0].row(faces[3 * (i - first[shape]) + k]));
    }
  }
  Ref ref(size_t i) const {
    const u32 shape = shape_of(i);
    const Aabb b = box(shape, i);
    return {{b.low[0], b.low[1], b.low[2]},
            static_cast<u32>(i),
            {b.high[0], b.high[1], b.high[2]},
            shape};
  }
  Aabb box(u32 shape, size_t i) const {
    const ShapeInput& s = shapes[shape];
    switch (s.kind) {
#define SHAPE(name, Type) \
  case ShapeKind::name: return box_of(make_primitive<baseline::Type>(s, i - first[shape], scale));
#include "../core/shapes.def"
#undef SHAPE
      case ShapeKind::instance: break;
    }
    return instance_boxes[instance_of(shape, i) - first_instance];
  }

  void write(ShapeKind kind, const u32* ids, size_t n, u32 index) const {
    switch (kind) {
#define SHAPE(name, Type) \
  case ShapeKind::name: fill<baseline::Type>(ids, n, name##s[index]); break;
#include "../core/shapes.def"
#undef SHAPE
      case ShapeKind::instance: break;
    }
  }
  template <class Shape, class Block>
  void fill(const u32* ids, size_t n, Block& block) const {
    Shape made[16];
    for (size_t i = 0; i < n; ++i) {
      const u32 shape = shape_of(ids[i]);
      made[i] = make_primitive<Shape>(shapes[shape], ids[i] - first[shape], scale);
    }
    const u32 without = left_out(made, ids, n);
    block = empty_block<Block>();
    for (size_t i = 0; i < n; ++i) {
      if (!(without >> i & 1u)) put(block, i, made[i], first_id + ids[i]);
    }
  }
};

// To [0.5, 1): exact, being a power of two.
double normalising(double extent) {
  return extent > 0.0 ? std::ldexp(1.0, -(std::ilogb(extent) + 1)) : 1.0;
}

struct Matrix {
  double m[12];

  void apply(const double (&p)[3], double (&out)[3]) const {
    for (int r = 0; r < 3; ++r) {
      out[r] = m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3];
    }
  }
  double determinant() const {
    return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
           m[2] * (m[4] * m[9] - m[5] * m[8]);
  }
  Matrix inverse() const {
    const double d = 1.0 / determinant();
    Matrix i{{(m[5] * m[10] - m[6] * m[9]) * d, (m[2] * m[9] - m[1] * m[10]) * d,
              (m[1] * m[6] - m[2] * m[5]) * d, 0.0, (m[6] * m[8] - m[4] * m[10]) * d,
              (m[0] * m[10] - m[2] * m[8]) * d, (m[2] * m[4] - m[0] * m[6]) * d, 0.0,
              (m[4] * m[9] - m[5] * m[8]) * d, (m[1] * m[8] - m[0] * m[9]) * d,
              (m[0] * m[5] - m[1] * m[4]) * d, 0.0}};
    for (int r = 0; r < 3; ++r) {
      i.m[4 * r + 3] = -(i.m[4 * r] * m[3] + i.m[4 * r + 1] * m[7] + i.m[4 * r + 2] * m[11]);
    }
    return i;
  }
};

Matrix transform_of(const ShapeInput& s, size_t i) {
  Matrix m;
  std::copy(s.transforms + 12 * i, s.transforms + 12 * (i + 1), m.m);
  return m;
}

// Of a group seen through a matrix: from normalised units of one to those of the other.
Matrix between(Matrix m, double from_scale, double to_scale) {
  for (int k = 0; k < 12; ++k) m.m[k] *= k % 4 == 3 ? to_scale : to_scale / from_scale;
  return m;
}

Aabb transformed(const Box& b, const Matrix& m) {
  Aabb out;
  for (int corner = 0; corner < 8; ++corner) {
    const double p[3] = {corner & 1 ? b.high.x : b.low.x, corner & 2 ? b.high.y : b.low.y,
                         corner & 4 ? b.high.z : b.low.z};
    double q[3];
    m.apply(p, q);
    float f[3];
    for (int k = 0; k < 3; ++k) f[k] = static_cast<float>(q[k]);
    out.grow(f);
  }
  // The ray is transformed in float, which moves it by some roundings of the scene's own size.
  for (int k = 0; k < 3; ++k) out.low[k] -= 0x1p-20f, out.high[k] += 0x1p-20f;
  return out;
}

// A place on a primitive, from two numbers in [0, 1].
void place_on(const baseline::Triangle&, float u, float v, baseline::SurfacePoint& p) {
  const float root = std::sqrt(u);
  p.parameter = {root * (1.0f - v), root * v};
}
void place_on(const baseline::Sphere&, float u, float v, baseline::SurfacePoint& p) {
  p.normal = baseline::uniform_sphere({u, v});
}
template <class Shape>
void place_on(const Shape&, float u, float v, baseline::SurfacePoint& p) {
  p.parameter = {u, v};
}

template <class Shape>
constexpr bool is_flat =
    std::is_same_v<Shape, baseline::Triangle> || std::is_same_v<Shape, baseline::Disk>;

Vec3 normal_of(const baseline::Triangle& t) {
  return baseline::to_float(baseline::normalize(doubled_area(t)));
}
Vec3 normal_of(const baseline::Disk& d) {
  return baseline::to_float(baseline::normalize(scaled_normal(d)));
}
template <class Shape>
Vec3 normal_of(const Shape&) {
  return {0, 0, 1};
}

}  // namespace

using tree::TreeBuilder;

struct Scene::PlannedTree {
  Leaves leaves;
  TreeBuilder<Leaves> builder;

  PlannedTree(Leaves&& primitives, size_t count)
      : leaves(std::move(primitives)), builder(count, leaves) {}

  u64 bytes() const {
    return builder.plan_bytes() + leaves.instance_boxes.capacity() * sizeof(Aabb);
  }
};

Scene::~Scene() = default;

Scene::Scene(SceneInput input, u64 memory_limit)
    : memory_plan_(memory_limit),
      bindings_(std::move(input.bindings)),
      textures_(std::move(input.textures)) {
  if (input.groups.empty()) input.groups.emplace_back();
  expect_input(input);
  for (const ImageInput& image : input.images) pyramids_.emplace_back(image);
  own_images_ = pyramids_.size();
  view_.textures.records = textures_.data();
  view_.textures.bindings = bindings_.data();

  // What primitives have of their own, by id.
  bool many_materials = false, colored = false;
  for (const GroupInput& group : input.groups) {
    for (const ShapeInput& s : group) {
      if (primitive_count_ + s.count > kMaxPrimitives) {
        throw SceneError("shape '" + s.name + "': the scene has more than " +
                         std::to_string(kMaxPrimitives) + " primitives");
      }
      primitive_count_ += s.count;
      count_of_[static_cast<u32>(s.kind)] += s.count;
      many_materials = many_materials || s.material_of;
      colored = colored || s.colors;
    }
  }
  const WakeApart apart(primitive_count_ > kFewElements ? omp_get_max_threads() : 1);
  if (many_materials) material_of_ = Array<u32>(primitive_count_);
  if (colored) {
    color_of_ = Array<Vec3>(primitive_count_);
    for_all(primitive_count_, [&](size_t i) { color_of_[i] = {kNan, kNan, kNan}; });
  }
  materials_ = std::move(input.materials);

  std::vector<BuiltGroup> built;
  built.reserve(input.groups.size());
  u32 next_id = 0;
  for (size_t g = 0; g < input.groups.size(); ++g) {
    add_group(input.groups[g], built, next_id, g + 1 == input.groups.size());
  }
  write_groups(built);
  scale_ = built.back().scale;

  view_.nodes = nodes_.data();
  view_.root = groups_.back().root;
  view_.bounds = built.back().bounds;
  view_.unit = 1.0 / scale_;
#define SHAPE(name, Type)          \
  view_.name##s = name##s_.data(); \
  view_.name##_blocks = static_cast<u32>(name##s_.size());
#include "../core/shapes.def"
#undef SHAPE
  view_.instances = instances_.data();
  view_.groups = groups_.data();
  view_.group_count = static_cast<u32>(groups_.size());
  view_.shapes = shapes_.data();
  guide_shapes(next_id);
  view_.material_of = material_of_.empty() ? nullptr : material_of_.data();
  view_.color_of = color_of_.empty() ? nullptr : color_of_.data();
  make_materials();
  expect_lights(input.lights, built);
  find_all_emitters(built);
  make_lights(std::move(input.lights));
}

// A search for a primitive's shape begins where the guide says: few steps, whatever their number.
void Scene::guide_shapes(u32 primitives) {
  constexpr u64 kEntriesPerShape = 8, kLeastEntries = 1024;
  const u64 most = kEntriesPerShape * shapes_.size() + kLeastEntries;
  u32 shift = 0;
  while ((u64{primitives} >> shift) + 2 > most) ++shift;
  u32 shape = 0;
  for (u64 id = 0; id <= u64{primitives} + (u64{1} << shift); id += u64{1} << shift) {
    while (shape + 1 < shapes_.size() && shapes_[shape + 1].first_id <= id) ++shape;
    shape_guide_.push_back(shape);
  }
  view_.shape_guide = shape_guide_.data();
  view_.shape_guide_shift = shift;
}

void Scene::set_materials(std::vector<MaterialRecord> materials) {
  if (materials.size() != materials_.size()) {
    throw SceneError("as many materials as the scene has are needed");
  }
  bool other_light = false;
  for (size_t i = 0; i < materials.size(); ++i) {
    const MaterialRecord &now = materials_[i], &then = materials[i];
    if (now.block.kind != then.block.kind) throw SceneError("a material keeps its type");
    if (shines(then) && !shines(now)) {
      throw SceneError("a material that does not shine cannot begin to");
    }
    const bool emissive = static_cast<MaterialKind>(now.block.kind) == MaterialKind::emissive;
    other_light = other_light || now.emission.x != then.emission.x ||
                  now.emission.y != then.emission.y || now.emission.z != then.emission.z ||
                  (emissive && std::memcmp(&now.block, &then.block, sizeof now.block) != 0);
  }
  materials_ = std::move(materials);
  make_materials();
  if (other_light) weigh_lights();
}

void Scene::set_lights(std::vector<LightInput> lights) {
  if (lights.size() != lights_.size()) {
    throw SceneError("as many lights as the scene has are needed");
  }
  make_lights(std::move(lights));
}

// What is known of the memory before any is taken: of the tree, what it takes with full leaves.
void Scene::expect_input(const SceneInput& input) {
  u64 kept = 0, passing = 0;
  for (const ImageInput& image : input.images) {
    const ImagePyramid::Needs n = ImagePyramid::needs(image);
    kept += n.kept;
    passing = std::max(passing, n.passing);
  }
  memory_plan_.expect(MemoryPlan::images, kept, passing);

  u64 primitives = 0, instances = 0, meshes = 0, blocks = 0;
  bool many_materials = false, colored = false;
  for (const GroupInput& group : input.groups) {
    for (const ShapeInput& s : group) {
      primitives += s.count;
      many_materials = many_materials || s.material_of;
      colored = colored || s.colors;
      if (s.kind == ShapeKind::instance) instances += s.count;
#define SHAPE(name, Type) \
  if (s.kind == ShapeKind::name) blocks += (s.count + 15) / 16 * sizeof(Type##Block);
#include "../core/shapes.def"
#undef SHAPE
      if (!s.faces) continue;
      const u64 own = (s.normals ? sizeof(Vec3) : 0) + (s.uvs ? sizeof(Vec2) : 0) +
                      (s.tangents ? sizeof(Tangent) : 0);
      meshes += s.count * 3 * sizeof(u32) + s.vertex_count * own;
      for (const AttributeInput& a : s.attributes) meshes += a.rows * a.components * sizeof(float);
    }
  }
  meshes += primitives * ((many_materials ? sizeof(u32) : 0) + (colored ? sizeof(Vec3) : 0));
  memory_plan_.expect(MemoryPlan::shapes, meshes, 0);
  memory_plan_.expect(MemoryPlan::instances, instances * sizeof(Instance), 0);
  instances_.reserve(instances);
  memory_plan_.expect(MemoryPlan::tree, blocks + primitives / 256 * sizeof(Node),
                      TreeBuilder<Leaves>::expected_bytes(primitives) + instances * sizeof(Aabb));
  memory_plan_.check();
}

// When the emissive primitives are counted.
void Scene::expect_lights(const std::vector<LightInput>& lights,
                          const std::vector<BuiltGroup>& built) {
  u64 listed = 0, emitters = built.back().emitters.size();
  for (const BuiltGroup& group : built) listed += group.emitters.size();
  for (const Instance& instance : instances_) emitters += built[instance.group].emitters.size();
  u64 kept = emitters * sizeof(Slot), passing = listed * sizeof(Slot);
  for (const LightInput& l : lights) {
    u64 texels = 0;
    const LightKind kind = static_cast<LightKind>(l.record.block.kind);
    if (kind == LightKind::sky) {
      texels = u64{kSkyWidth} * kSkyHeight;
      kept += 3 * texels * sizeof(float);
    } else if (kind == LightKind::envmap) {
      const ImageView image = pyramids_[l.record.image].view();
      texels = u64{image.width} * image.height;
    }
    kept += DistributionTable::bytes(texels);
    passing += texels * sizeof(double);
  }
  const u64 leaves = emitters + lights.size();
  const LightTreeNeeds tree = light_tree_needs(leaves);
  memory_plan_.expect(MemoryPlan::lights, kept + tree.kept,
                      passing + leaves * sizeof(LightLeaf) + tree.passing);
  memory_plan_.check();
}

// How far from the origin a shape may reach, in the scene's unit: coordinates are floats, which end
// at 3.4e38, and their sums must be some, too.
static constexpr double kFarthest = 1e37;
// A copy's extent may be smaller than the scene's by this; lengths in its frame are squared.
static constexpr double kMostShrunk = 1e15;

void Scene::add_group(const GroupInput& shapes, std::vector<BuiltGroup>& built, u32& next_id,
                      bool own) {
  double extent = 0.0;
  size_t count = 0;
  const SceneChecks checks(materials_);
  std::vector<ColorRange> color_ranges;
  for (const BuiltGroup& b : built) color_ranges.push_back(b.colors);
  for (const ShapeInput& s : shapes) {
    double size = 0.0;
    if (s.kind != ShapeKind::instance) {
      size = checks.extent(s);
    } else {
      if (!own) throw SceneError("shape '" + s.name + "': instances within a group of instances");
      checks.instances(s, color_ranges);
      for (size_t i = 0; i < s.count; ++i) {
        const Aabb b = transformed(built[s.group].bounds,
                                   between(transform_of(s, i), built[s.group].scale, 1.0));
        for (int k = 0; k < 3; ++k) {
          size = std::max({size, static_cast<double>(std::fabs(b.low[k])),
                           static_cast<double>(std::fabs(b.high[k]))});
        }
      }
    }
    if (!(size <= kFarthest)) {
      char reach[64];
      std::snprintf(reach, sizeof reach, "%.3g from the origin; %g is the most", size, kFarthest);
      throw SceneError("shape '" + s.name + "': reaches " + reach);
    }
    extent = std::max(extent, size);
    count += s.count;
  }
  for (const ShapeInput& s : shapes) checks.sizes(s, extent);
  BuiltGroup group{normalising(extent), {}, {}, checks.colors(shapes), {}};

  // Records, and the emitters' places in the group's list.
  Leaves leaves{shapes, group.scale, next_id, {}, {}, {}, static_cast<u32>(instances_.size())};
  if (own) leaves.instance_boxes.reserve(instances_.capacity());
  u32 emitters = 0;
  for (const ShapeInput& s : shapes) {
    leaves.first.push_back(next_id - leaves.first_id);
    leaves.instances.push_back(static_cast<u32>(instances_.size()));
    ShapeRecord record{};
    record.first_id = next_id;
    record.material = s.material_of ? kNone : s.material;
    record.inside_out = s.inside_out;
    record.first_emitter = kNone;
    std::copy(s.rotation, s.rotation + 9, record.rotation);
    if (s.kind == ShapeKind::instance) {
      record.material = 0;
      for (size_t i = 0; i < s.count; ++i) {
        const BuiltGroup& shown = built[s.group];
        const Matrix m = between(transform_of(s, i), shown.scale, group.scale);
        const Matrix inverse = m.inverse();
        for (double x : inverse.m) {
          if (!(std::fabs(x) <= kMostShrunk)) {
            throw SceneError("shape '" + s.name + "': transforms[" + std::to_string(i) +
                             "] makes what it places too small beside the scene's extent");
          }
        }
        Instance instance{};
        for (int k = 0; k < 12; ++k) {
          instance.to_scene[k] = static_cast<float>(m.m[k]);
          instance.to_group[k] = static_cast<float>(inverse.m[k]);
        }
        instance.group = s.group;
        instance.determinant = static_cast<float>(std::fabs(inverse.determinant()));
        instance.shape = static_cast<u32>(shapes_.size());
        instance.id = next_id + static_cast<u32>(i);
        instances_.push_back(instance);
        leaves.instance_boxes.push_back(transformed(shown.bounds, m));
      }
    } else {
      bool lit = false;
      for (u32 m : checks.materials(s)) lit = lit || shines(materials_[m]);
      if (lit) {
        record.first_emitter = emitters;
        emitters += static_cast<u32>(s.count);
      }
      if (s.faces) keep_mesh(s, record);
    }
    if (s.material_of) {
      for_all(s.count, [&](size_t i) { material_of_[next_id + i] = s.material_of[i]; });
    }
    if (s.colors) {
      for_all(s.count, [&](size_t i) {
        color_of_[next_id + i] = {s.colors[3 * i], s.colors[3 * i + 1], s.colors[3 * i + 2]};
      });
    }
    next_id += static_cast<u32>(s.count);
    shapes_.push_back(record);
  }
  group.emitters.assign(emitters, kNoSlot);
  group.tree = std::make_unique<PlannedTree>(std::move(leaves), count);
  u64 planned = TreeBuilder<Leaves>::expected_bytes(count);
  for (const BuiltGroup& b : built) planned += b.tree->bytes();
  const size_t lost = group.tree->builder.plan([&](u64 copied) {
    planning_ = std::max(planning_, planned + copied);
    memory_plan_.expect(MemoryPlan::planning, 0, planning_);
    memory_plan_.check();
  });
  // A cylinder whose ends are one point beside the scene's extent has no direction.
  if (lost < count) {
    const Leaves& l = group.tree->leaves;
    const u32 shape = l.shape_of(lost);
    throw SceneError("shape '" + shapes[shape].name + "': primitive " +
                     std::to_string(lost - l.first[shape]) +
                     " is too small or too thin for single precision beside the scene's extent");
  }
  const Aabb b = group.tree->builder.bounds();
  group.bounds = {{b.low[0], b.low[1], b.low[2]}, {b.high[0], b.high[1], b.high[2]}};
  built.push_back(std::move(group));
}

// The trees of all groups, in arrays that are as large as they must be.
void Scene::write_groups(std::vector<BuiltGroup>& built) {
  size_t nodes = 0;
  std::array<size_t, 8> blocks{};
  for (const BuiltGroup& group : built) {
    nodes += group.tree->builder.node_count();
    for (size_t k = 0; k < 8; ++k) blocks[k] += group.tree->builder.block_count()[k];
  }
  if (nodes > kLeafIndexMask || *std::max_element(blocks.begin(), blocks.end()) > kLeafIndexMask) {
    throw SceneError("the scene has too many primitives for its tree");
  }
  u64 kept = nodes * sizeof(Node), planned = 0;
#define SHAPE(name, Type) kept += blocks[static_cast<u32>(ShapeKind::name)] * sizeof(Type##Block);
#include "../core/shapes.def"
#undef SHAPE
  for (const BuiltGroup& group : built) planned += group.tree->bytes();
  memory_plan_.expect(MemoryPlan::tree, kept, planned);
  memory_plan_.check();
  nodes_ = Array<Node>(nodes);
#define SHAPE(name, Type) name##s_ = Array<Type##Block>(blocks[static_cast<u32>(ShapeKind::name)]);
#include "../core/shapes.def"
#undef SHAPE
  u32 node = 0, instance = 0;
  KindCounts block{};
  for (BuiltGroup& group : built) {
    const TreeBuilder<Leaves>& builder = group.tree->builder;
    Group place{};
    const KindCounts base = block;
    for (size_t k = 0; k < 8; ++k) block[k] += static_cast<u32>(builder.block_count()[k]);
#define SHAPE(name, Type)                                       \
  group.tree->leaves.name##s = name##s_.data();                 \
  place.first_##name = base[static_cast<u32>(ShapeKind::name)]; \
  place.last_##name = block[static_cast<u32>(ShapeKind::name)];
#include "../core/shapes.def"
#undef SHAPE
    place.first_instance = instance;
    instance += static_cast<u32>(group.tree->leaves.instance_boxes.size());
    place.last_instance = instance;
    place.root = group.tree->builder.write(nodes_.data() + node, node, base);
    node += static_cast<u32>(builder.node_count());
    groups_.push_back(place);
    group.tree = nullptr;
    find_emitters(group, place);
  }
  for (Instance& i : instances_) i.root = groups_[i.group].root;
}

// Where the emitters have come to lie; those that are left out of their leaves lie nowhere.
void Scene::find_emitters(BuiltGroup& group, const Group& place) const {
  if (group.emitters.empty()) return;
  const auto find = [&](const auto& blocks, ShapeKind kind, u32 first, u32 last) {
    for (u32 b = first; b < last; ++b) {
      for (u32 lane = 0; lane < 16; ++lane) {
        const u32 id = blocks[b].id[lane];
        if (id == kNone) continue;
        const ShapeRecord& r =
            *(std::upper_bound(shapes_.begin(), shapes_.end(), id,
                               [](u32 x, const ShapeRecord& shape) { return x < shape.first_id; }) -
              1);
        if (r.first_emitter == kNone) continue;
        group.emitters[r.first_emitter + (id - r.first_id)] = {make_leaf(kind, b), lane, kNone};
      }
    }
  };
#define SHAPE(name, Type) find(name##s_, ShapeKind::name, place.first_##name, place.last_##name);
#include "../core/shapes.def"
#undef SHAPE
}

// The direction of three numbers, 0 of 0.
static Vec3 unit(const float* v) {
  const double x = v[0], y = v[1], z = v[2];
  const double size = std::sqrt(x * x + y * y + z * z);
  const double k = size > 0.0 ? 1.0 / size : 0.0;
  return {static_cast<float>(x * k), static_cast<float>(y * k), static_cast<float>(z * k)};
}

// n elements, of which make(i) is the ith.
template <class T, class Make>
static Array<T> array_of(size_t n, const Make& make) {
  Array<T> made(n);
  for_all(n, [&](size_t i) { made[i] = make(i); });
  return made;
}

void Scene::keep_mesh(const ShapeInput& s, ShapeRecord& record) {
  auto data = std::make_unique<MeshData>();
  data->faces = array_of<u32>(3 * s.count, [&](size_t i) { return s.faces[i]; });
  record.faces = data->faces.data();
  if (s.normals) {
    data->normals =
        array_of<Vec3>(s.vertex_count, [&](size_t i) { return unit(s.normals + 3 * i); });
    record.normals = data->normals.data();
  }
  if (s.uvs) {
    data->uvs = array_of<Vec2>(s.vertex_count,
                               [&](size_t i) -> Vec2 { return {s.uvs[2 * i], s.uvs[2 * i + 1]}; });
    record.uvs = data->uvs.data();
  }
  if (s.tangents) {
    data->tangents = array_of<Tangent>(s.vertex_count, [&](size_t i) -> Tangent {
      const float* t = s.tangents + 4 * i;
      return {unit(t), t[3] < 0.0f ? -1.0f : 1.0f};
    });
    record.tangents = data->tangents.data();
  }
  for (const AttributeInput& a : s.attributes) {
    const Array<float>& values = data->values.emplace_back(
        array_of<float>(a.rows * a.components, [&](size_t i) { return a.values[i]; }));
    data->attributes.push_back({values.data(), a.name, a.components, a.per_face});
  }
  record.attributes = data->attributes.data();
  record.attribute_count = static_cast<u32>(data->attributes.size());
  meshes_.push_back(std::move(data));
}

bool Scene::shines(const MaterialRecord& m) const {
  using baseline::black;
  return !black(m.emission) || static_cast<MaterialKind>(m.block.kind) == MaterialKind::emissive;
}

// Whether light that goes through the material's surface is then inside of a body.
static bool has_inside(const MaterialRecord& m) {
  return baseline::with_material(m.block, [](const auto& material) {
    using Material = std::decay_t<decltype(material)>;
    return requires { Material::transmits; } && !requires { Material::thin; };
  });
}

// What is worked out of parameters that are the same everywhere. bindings: its own.
static void derive(MaterialRecord& m, const TextureBinding* bindings) {
  for (u32 i = 0; i < m.binding_count; ++i) {
    if (bindings[i].offset != 0) return;  // the colour's
  }
  baseline::with_material(m.block, [&](auto material) {
    if constexpr (requires { derive(material); }) {
      derive(material);
      baseline::to_block(material, m.block);
    }
  });
}

void Scene::make_materials() {
  const float per_unit = static_cast<float>(1.0 / scale_);
  view_.has_bodies = view_.has_holes = false;
  for (u32 i = 0; i < materials_.size(); ++i) {
    MaterialRecord& m = materials_[i];
    m.absorption = {m.absorption.x * per_unit, m.absorption.y * per_unit,
                    m.absorption.z * per_unit};
    m.bump_scale *= static_cast<float>(scale_);
    scale_lengths(m.block, material_params(m.block.kind), scale_);
    m.clear = static_cast<MaterialKind>(m.block.kind) == MaterialKind::null && m.priority == 0 &&
              baseline::black(m.absorption) && m.blend_first == kNone && m.back == i;
    derive(m, bindings_.data() + m.first_binding);
    const bool textured = m.binding_count != 0 || m.normal_map != kNone;
    m.traits = (m.traits & kUsesUv) | (textured ? kTextured : 0) | (shines(m) ? kShines : 0) |
               (m.emission_texture != kNone ? kShinesByTexture : 0) |
               (m.blend_first != kNone ? kBlends : 0) | (m.back != i ? kTwoSided : 0) |
               m.block.kind << kKindShift;
    m.body = has_inside(m) && (m.priority != 0 || !baseline::black(m.absorption));
    view_.has_bodies = view_.has_bodies || m.body;
    view_.has_holes =
        view_.has_holes || m.clear || m.opacity < 1.0f || m.opacity_texture.texture != kNone;
  }
  // Where there are bodies, what lies within them counts as one too: air in coloured glass.
  for (MaterialRecord& m : materials_)
    m.body = m.body || (view_.has_bodies && has_inside(m) && !m.clear);
  view_.materials = materials_.data();
}

// Emissive primitives: the scene's own, then each instance's.
void Scene::find_all_emitters(const std::vector<BuiltGroup>& built) {
  size_t emitters = built.back().emitters.size();
  for (const Instance& instance : instances_) emitters += built[instance.group].emitters.size();
  emitters_.reserve(emitters);
  emitters_ = built.back().emitters;
  for (size_t i = 0; i < instances_.size(); ++i) {
    Instance& instance = instances_[i];
    instance.first_emitter = static_cast<u32>(emitters_.size());
    for (Slot slot : built[instance.group].emitters) {
      slot.instance = static_cast<u32>(i);
      emitters_.push_back(slot);
    }
  }
  view_.emitters = emitters_.data();
  view_.emitter_count = static_cast<u32>(emitters_.size());
}

void Scene::make_lights(std::vector<LightInput> inputs) {
  lights_.clear();
  light_names_.clear();
  pyramids_.erase(pyramids_.begin() + static_cast<std::ptrdiff_t>(own_images_), pyramids_.end());
  distributions_.clear();
  distribution_views_.clear();
  view_.outside_first = view_.smooth_first = 0;
  // Those that lie in the scene before those from outside, and those before the ones not asked for.
  const auto place = [](const LightInput& l) {
    return baseline::is_outside(l.record) ? baseline::is_smooth(l.record) ? 2 : 1 : 0;
  };
  std::stable_sort(inputs.begin(), inputs.end(),
                   [&](const LightInput& a, const LightInput& b) { return place(a) < place(b); });
  for (LightInput& l : inputs) {
    LightRecord& r = l.record;
    scale_lengths(r.block, light_params(r.block.kind), scale_);
    const float k = static_cast<float>(scale_);
    r.position = {r.position.x * k, r.position.y * k, r.position.z * k};
    tabulate(r);
    lights_.push_back(r);
    light_names_.push_back(l.name);
    if (place(l) == 0) ++view_.outside_first;
    if (place(l) <= 1) ++view_.smooth_first;
  }
  images_.clear();
  for (const ImagePyramid& p : pyramids_) images_.push_back(p.view());
  view_.textures.images = images_.data();
  for (const DistributionTable& d : distributions_) distribution_views_.push_back(d.view());
  view_.lights = lights_.data();
  view_.light_count = static_cast<u32>(lights_.size());
  view_.tables = {images_.data(), distribution_views_.data()};
  weigh_lights();
}

// The tree of lights, and how many samples go to those outside.
void Scene::weigh_lights() {
  std::vector<LightLeaf> leaves(emitters_.size() + view_.outside_first);
  for_all(emitters_.size(), [&](size_t i) { leaves[i] = leaf_of(emitters_[i]); });
  for (u32 i = 0; i < view_.outside_first; ++i) {
    const LightReach r = baseline::light_reach(lights_[i], view_.tables);
    leaves[emitters_.size() + i] = {{r.position, r.position}, r.axis, r.cos_o, r.cos_e, r.power, 0};
  }
  light_count_ = view_.smooth_first - view_.outside_first;
  for (const LightLeaf& leaf : leaves) light_count_ += leaf.power > 0.0f;
  share_outside(leaves);
  light_tree_ = build_light_tree(std::move(leaves));
  view_.light_tree = light_tree_.view();
}

// The median distance of the scene's primitives and instances, of many some, from a point: of what
// a picture shows, most is about so far away, however large the ground may be.
double Scene::usual_distance(Vec3 from) const {
  constexpr u32 kSome = 256;  // blocks, or sixteen instances each
  std::vector<double> distances;
  const auto add = [&](Vec3 at) {
    distances.push_back(std::hypot(static_cast<double>(at.x - from.x),
                                   static_cast<double>(at.y - from.y),
                                   static_cast<double>(at.z - from.z)));
  };
  const Group& own = groups_.back();
  u32 blocks = (own.last_instance - own.first_instance) / 16;
#define SHAPE(name, Type) blocks += own.last_##name - own.first_##name;
#include "../core/shapes.def"
#undef SHAPE
  const u32 step = std::max(blocks / kSome, 1u);
#define SHAPE(name, Type)                                                        \
  for (u32 b = own.first_##name; b < own.last_##name; b += step) {               \
    for (u32 lane = 0; lane < 16; ++lane) {                                      \
      if (name##s_[b].id[lane] == kNone) continue;                               \
      const Aabb box = box_of(baseline::primitive(name##s_[b], lane));           \
      add({0.5f * (box.low[0] + box.high[0]), 0.5f * (box.low[1] + box.high[1]), \
           0.5f * (box.low[2] + box.high[2])});                                  \
    }                                                                            \
  }
#include "../core/shapes.def"
#undef SHAPE
  for (u32 i = own.first_instance; i < own.last_instance; i += step) {
    const float (&m)[12] = instances_[i].to_scene;
    add({m[3], m[7], m[11]});
  }
  if (distances.empty()) return 0.0;
  const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  return *middle;
}

// How many of the samples for light go outside, and to which of the lights there: by the irradiance
// of what they give, found by samples spread evenly, and of what lights in the scene give where
// most of it lies. As neither says what is hidden where, all lights from outside share a part
// evenly, and both kinds get a part whatever they give.
void Scene::share_outside(const std::vector<LightLeaf>& leaves) {
  constexpr u32 kSamples = 1024;
  constexpr double kEvenly = 0.1;
  const u32 first = view_.outside_first, end = view_.smooth_first;
  std::vector<double> given(end - first);
  double whole = 0.0;
  for (u32 i = first; i < end; ++i) {
    for (u32 k = 0; k < kSamples; ++k) {
      const float x = (static_cast<float>(k) + 0.5f) / kSamples;
      const float y = static_cast<float>(baseline::reverse_bits(k) >> 8) * 0x1p-24f;
      const LightSample s = baseline::sample_light(lights_[i], view_.tables, {0, 0, 0}, {x, y});
      if (s.pdf > 0.0f) {
        given[i - first] += static_cast<double>(baseline::luminance(s.radiance) / s.pdf) / kSamples;
      }
    }
    given[i - first] = std::min(given[i - first], 1e30);  // finite, also the sum
    whole += given[i - first];
  }
  for (u32 i = first; i < end; ++i) {
    const double part = whole > 0.0 ? given[i - first] / whole : 1.0 / (end - first);
    lights_[i].share = static_cast<float>(kEvenly / (end - first) + (1.0 - kEvenly) * part);
  }
  double own = 0.0, x = 0.0, y = 0.0, z = 0.0;
  for (const LightLeaf& leaf : leaves) {
    const double power = static_cast<double>(leaf.power);
    const Box& box = leaf.bounds;
    own += power;
    x += power * static_cast<double>(0.5f * (box.low.x + box.high.x));
    y += power * static_cast<double>(0.5f * (box.low.y + box.high.y));
    z += power * static_cast<double>(0.5f * (box.low.z + box.high.z));
  }
  view_.outside_share = first == end ? 0.0f : 1.0f;
  if (first == end || !(own > 0.0)) return;
  // Of light, from wherever it comes, a quarter arrives at a surface that faces anywhere; and of
  // its greatest intensity a flat light has a quarter in the mean of all directions.
  const double distance = usual_distance(
      {static_cast<float>(x / own), static_cast<float>(y / own), static_cast<float>(z / own)});
  const double from_outside = 0.25 * whole, from_own = 0.25 * 0.25 * own / (distance * distance);
  view_.outside_share = static_cast<float>(
      std::clamp(from_outside / (from_outside + from_own), kEvenly, 1.0 - kEvenly));
}

// The images and distributions of lights that need some.
void Scene::tabulate(LightRecord& r) {
  const auto keep = [&](DistributionTable table) {
    r.distribution = static_cast<u32>(distributions_.size());
    distributions_.push_back(std::move(table));
  };
  const auto make_image = [&](const char* name, const float* values, u32 width, u32 height) {
    r.image = static_cast<u32>(pyramids_.size());
    pyramids_.emplace_back(
        ImageInput{name, values, SampleType::float32, width, height, 3, false, false});
  };
  switch (static_cast<LightKind>(r.block.kind)) {
    case LightKind::envmap: {
      const auto light = baseline::from_block<baseline::Envmap>(r.block);
      const ImageView image = pyramids_[r.image].view();
      keep(baseline::is_latlong(light) ? latlong_distribution(image)
                                       : equal_area_distribution(image));
      break;
    }
    case LightKind::sky: {
      const auto sky = baseline::from_block<baseline::Sky>(r.block);
      const std::vector<float> values = sky_image(sky.sun_direction, sky.turbidity, sky.albedo);
      make_image("sky", values.data(), kSkyWidth, kSkyHeight);
      keep(latlong_distribution(pyramids_.back().view()));
      break;
    }
    case LightKind::sun: {
      const auto sun = baseline::from_block<baseline::Sun>(r.block);
      const Vec3 shine = sun_radiance(sun.sun_direction, sun.turbidity, sun.angle);
      make_image("sun", &shine.x, 1, 1);
      break;
    }
    default: break;
  }
}

// Power is the flux per steradian of a flat light seen from its front: area times radiance.
LightLeaf Scene::leaf_of(const Slot& slot) const {
  using namespace baseline;
  LightLeaf dark{{{0, 0, 0}, {0, 0, 0}}, {0, 0, 1}, -1.0f, 0.0f, 0.0f, 0};
  if (slot.leaf == kNone) return dark;
  const Instance* instance = instance_of(view_, slot);
  return with_primitive(view_, slot, [&](const auto& shape, u32 id) {
    LightLeaf leaf = dark;
    const Aabb b = box_of(shape);
    Box box = {{b.low[0], b.low[1], b.low[2]}, {b.high[0], b.high[1], b.high[2]}};
    float size = area(shape);
    if (instance) {
      Matrix matrix;
      for (int k = 0; k < 12; ++k) matrix.m[k] = static_cast<double>(instance->to_scene[k]);
      const Aabb t = transformed(box, matrix);
      box = {{t.low[0], t.low[1], t.low[2]}, {t.high[0], t.high[1], t.high[2]}};
      size *= static_cast<float>(std::pow(std::fabs(matrix.determinant()), 2.0 / 3.0));
    }
    leaf.bounds = box;

    // The mean of what it gives off: of a texture, over places spread evenly.
    Surface s{};
    s.slot = slot;
    const MaterialRecord& m = baseline::material_of(view_, shape_of(view_, id), id);
    const bool both =
        m.emits_back || static_cast<MaterialKind>(m.block.kind) == MaterialKind::emissive;
    const bool textured = m.emission_texture != kNone;
    const int n = textured ? 16 : 1;
    float sum = 0.0f;
    for (int i = 0; i < n; ++i) {
      SurfacePoint p{{0, 0, 0}, normal_of(shape), {0, 0}, 0.0f};
      place_on(shape, (static_cast<float>(i) + 0.5f) / static_cast<float>(n),
               static_cast<float>(i * 7 % 16) / 16.0f + 1.0f / 32.0f, p);
      complete(view_, shape, id, p, instance, false, s);
      sum += luminance(emission(view_, *s.material, s, true));
    }
    constexpr bool flat = is_flat<std::decay_t<decltype(shape)>>;
    if (flat && !both) {
      leaf.axis = s.normal;
      leaf.cos_o = 1.0f;
    }
    // Where samples of a texture find nothing there may be some light all the same.
    const float floor = textured ? 1e-3f * luminance(s.material->emission) : 0.0f;
    leaf.power = size * std::max(sum / static_cast<float>(n), floor) * (flat ? 1.0f : 0.25f);
    return leaf;
  });
}

size_t Scene::block_count() const {
  size_t n = 0;
#define SHAPE(name, Type) n += name##s_.size();
#include "../core/shapes.def"
#undef SHAPE
  return n;
}

size_t Scene::memory() const {
  size_t n =
      nodes_.bytes() + instances_.capacity() * sizeof(Instance) +
      shapes_.capacity() * sizeof(ShapeRecord) + shape_guide_.capacity() * sizeof(u32) +
      materials_.capacity() * sizeof(MaterialRecord) + material_of_.bytes() + color_of_.bytes() +
      emitters_.capacity() * sizeof(Slot) + light_tree_.nodes.capacity() * sizeof(LightNode) +
      (light_tree_.slot_of_node.capacity() + light_tree_.slot_of_light.capacity()) * sizeof(u32);
#define SHAPE(name, Type) n += name##s_.bytes();
#include "../core/shapes.def"
#undef SHAPE
  for (const auto& mesh : meshes_) {
    n += mesh->faces.bytes() + mesh->normals.bytes() + mesh->uvs.bytes() + mesh->tangents.bytes();
    for (const Array<float>& values : mesh->values) n += values.bytes();
  }
  for (const ImagePyramid& p : pyramids_) n += p.memory();
  return n;
}

}  // namespace parhelion
