#include "scene.h"

#include <cmath>
#include <cstdio>
#include <limits>

#include "build.h"
#include "errors.h"

namespace parhelion {
namespace {

constexpr size_t kMaxPrimitives = 0xfffffff0u;  // ids are 32 bits, and ~0 is none

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.9g", x);
  return buffer;
}

double number(const void* array, bool is_double, size_t i) {
  return is_double ? static_cast<const double*>(array)[i]
                   : static_cast<double>(static_cast<const float*>(array)[i]);
}

double radius_of(const SphereGroup& g, size_t i) {
  return number(g.radii, g.radii_double, g.one_radius ? 0 : i);
}

[[noreturn]] void fail(const SphereGroup& g, const char* field, size_t i, const std::string& what) {
  throw SceneError("shape '" + g.name + "': " + field + "[" + std::to_string(i) + "] is " + what);
}

// The values that a primitive's own colour may have: those of its material's first parameter.
struct ColorRange {
  float low, high;
  const char* material;
};

ColorRange color_range(const ParamBlock& material) {
  switch (static_cast<MaterialKind>(material.kind)) {
#define MATERIAL(name, Type) \
  case MaterialKind::name:   \
    return {baseline::Type::params[0].low, baseline::Type::params[0].high, #name};
#include "../core/materials.def"
#undef MATERIAL
  }
  throw SceneError("a material of unknown kind");
}

// Checks every element; returns the largest |coordinate| + radius. The loop only gathers, and
// looks for the culprit when there is one, so that it runs at the speed of memory.
double check(const SphereGroup& g, const std::vector<ColorRange>& colors) {
  const size_t material_count = colors.size();
  const auto range_of = [&](size_t i) {
    return colors[g.material_of ? g.material_of[i] : g.material];
  };
  double extent = 0.0;
  bool sound = true;
#pragma omp parallel for reduction(max : extent) reduction(&& : sound)
  for (size_t i = 0; i < g.count; ++i) {
    const double r = radius_of(g, i);
    double size = 0.0;
    for (size_t k = 0; k < 3; ++k) {
      const double c = number(g.centers, g.centers_double, 3 * i + k);
      size = std::max(size, std::fabs(c));
      sound = sound && std::isfinite(c);
    }
    sound = sound && std::isfinite(r) && r > 0.0;
    sound = sound && (!g.material_of || g.material_of[i] < material_count);
    for (size_t k = 0; sound && g.colors && k < 3; ++k) {
      const float c = g.colors[3 * i + k];
      sound = c >= range_of(i).low && c <= range_of(i).high;
    }
    extent = std::max(extent, size + r);
  }
  for (size_t i = 0; !sound && i < g.count; ++i) {
    for (size_t k = 0; k < 3; ++k) {
      const double c = number(g.centers, g.centers_double, 3 * i + k);
      if (!std::isfinite(c)) {
        fail(g, "centers", i, std::string("not finite: ") + "xyz"[k] + " = " + text(c));
      }
    }
    const double r = radius_of(g, i);
    if (!std::isfinite(r) || !(r > 0.0)) {
      fail(g, "radii", i, text(r) + "; a radius must be finite and greater than 0");
    }
    if (g.material_of && g.material_of[i] >= material_count) {
      fail(g, "material", i,
           std::to_string(g.material_of[i]) + "; the scene has materials 0 to " +
               std::to_string(material_count - 1));
    }
    for (size_t k = 0; g.colors && k < 3; ++k) {
      const float c = g.colors[3 * i + k];
      const ColorRange range = range_of(i);
      if (!(c >= range.low && c <= range.high)) {
        fail(g, "colors", i,
             text(static_cast<double>(c)) + " in " + "rgb"[k] + "; the colour of " +
                 range.material + " must lie in [" + text(range.low) + ", " + text(range.high) +
                 "]");
      }
    }
  }
  if (!std::isfinite(extent)) {
    throw SceneError("shape '" + g.name + "': its coordinates are too large to add to its radii");
  }
  return extent;
}

// Refuses spheres whose squared radius would be lost beside a scene of the given extent.
void check_sizes(const SphereGroup& g, double extent) {
  constexpr double kSmallest = 1e-15;
  const size_t radii = g.one_radius ? std::min<size_t>(g.count, 1) : g.count;
  double least = extent;
#pragma omp parallel for reduction(min : least)
  for (size_t i = 0; i < radii; ++i) least = std::min(least, radius_of(g, i));
  if (least >= kSmallest * extent) return;
  for (size_t i = 0; i < radii; ++i) {
    if (radius_of(g, i) < kSmallest * extent) {
      fail(g, "radii", i,
           text(radius_of(g, i)) + ", but the scene reaches out to " + text(extent) +
               "; spheres of less than 1e-15 of that cannot be rendered with it");
    }
  }
}

struct SphereRef {
  float x, y, z, radius;
  u32 id;

  float center(int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
  // Padded by the rounding of a centre's distance from a ray's origin within the scene.
  Aabb box() const {
    Aabb b;
    for (int k = 0; k < 3; ++k) {
      const float c = center(k);
      const float half = radius + (std::fabs(c) + radius) * 0x1p-21f;
      b.low[k] = c - half;
      b.high[k] = c + half;
    }
    return b;
  }
};

// Of spheres that coincide, the one of the lowest id stands for all: a ray that starts on one would
// otherwise meet its twin at once, or not, as rounding has it. Centres that coincide share a leaf
// unless there are more of them than it holds.
bool has_twin_before(const SphereRef* refs, size_t n, const SphereRef& r) {
  for (size_t i = 0; i < n; ++i) {
    const SphereRef& other = refs[i];
    if (other.id < r.id && other.x == r.x && other.y == r.y && other.z == r.z &&
        other.radius == r.radius) {
      return true;
    }
  }
  return false;
}

SphereBlock make_block(const SphereRef* refs, size_t n) {
  SphereBlock b;
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  for (size_t i = 0; i < 16; ++i) {
    const bool used = i < n && !has_twin_before(refs, n, refs[i]);
    b.x[i] = used ? refs[i].x : nan;
    b.y[i] = used ? refs[i].y : nan;
    b.z[i] = used ? refs[i].z : nan;
    b.radius[i] = used ? refs[i].radius : nan;
    b.id[i] = used ? refs[i].id : kNone;
  }
  return b;
}

}  // namespace

Scene::Scene(const std::vector<SphereGroup>& groups, std::vector<ParamBlock> materials,
             const ParamBlock& background)
    : materials_(std::move(materials)) {
  std::vector<ColorRange> ranges;
  for (const ParamBlock& m : materials_) ranges.push_back(color_range(m));
  double extent = 0.0;
  bool many_materials = false, colored = false;
  u32 first_material = groups.empty() ? 0 : groups[0].material;
  for (const SphereGroup& g : groups) {
    if (sphere_count_ + g.count > kMaxPrimitives) {
      throw SceneError("shape '" + g.name + "': the scene has more than " +
                       std::to_string(kMaxPrimitives) + " spheres");
    }
    if (!g.material_of && g.material >= materials_.size()) {
      throw SceneError("shape '" + g.name + "': material " + std::to_string(g.material) + " of " +
                       std::to_string(materials_.size()));
    }
    extent = std::max(extent, check(g, ranges));
    sphere_count_ += g.count;
    many_materials = many_materials || g.material_of || g.material != first_material;
    colored = colored || g.colors;
  }
  // To [0.5, 1): exact, being a power of two.
  if (extent > 0.0) scale_ = std::ldexp(1.0, -(std::ilogb(extent) + 1));

  for (const SphereGroup& g : groups) check_sizes(g, extent);

  std::vector<SphereRef> refs(sphere_count_);
  if (many_materials || (first_material != 0 && sphere_count_ > 0)) {
    material_of_.resize(sphere_count_);
  }
  if (colored) color_of_.resize(sphere_count_);
  size_t base = 0;
  for (const SphereGroup& g : groups) {
#pragma omp parallel for
    for (size_t i = 0; i < g.count; ++i) {
      const auto at = [&](size_t k) {
        return static_cast<float>(number(g.centers, g.centers_double, 3 * i + k) * scale_);
      };
      const float radius = static_cast<float>(radius_of(g, i) * scale_);
      refs[base + i] = {at(0), at(1), at(2), radius, static_cast<u32>(base + i)};
      if (!material_of_.empty()) {
        material_of_[base + i] = g.material_of ? g.material_of[i] : g.material;
      }
      if (colored) {
        const float nan = std::numeric_limits<float>::quiet_NaN();
        color_of_[base + i] = g.colors
                                  ? Vec3{g.colors[3 * i], g.colors[3 * i + 1], g.colors[3 * i + 2]}
                                  : Vec3{nan, nan, nan};
      }
    }
    base += g.count;
  }

  TreeBuilder<SphereRef, SphereBlock> tree(refs, ShapeKind::sphere, make_block);
  tree.build();
  if (refs.empty()) {
    tree.blocks.push_back(make_block(nullptr, 0));  // a leaf that nothing hits
    tree.root = make_leaf(ShapeKind::sphere, 0);
    tree.bounds.grow({{0, 0, 0}, {0, 0, 0}});
  }
  nodes_ = std::move(tree.nodes);
  spheres_ = std::move(tree.blocks);

  view_.nodes = nodes_.data();
  view_.root = tree.root;
  view_.bounds = {{tree.bounds.low[0], tree.bounds.low[1], tree.bounds.low[2]},
                  {tree.bounds.high[0], tree.bounds.high[1], tree.bounds.high[2]}};
  view_.spheres = spheres_.data();
  view_.sphere_blocks = static_cast<u32>(spheres_.size());
  view_.materials = materials_.data();
  view_.material_of = material_of_.empty() ? nullptr : material_of_.data();
  view_.color_of = color_of_.empty() ? nullptr : color_of_.data();
  view_.background = background;
  make_emitters();
}

void Scene::make_emitters() {
  using namespace baseline;
  const bool any = [&] {
    for (const ParamBlock& m : materials_) {
      if (static_cast<MaterialKind>(m.kind) == MaterialKind::emissive) return true;
    }
    return false;
  }();
  if (!any) return;
  std::vector<double> weights;
  double total = 0.0;
  for (u32 b = 0; b < view_.sphere_blocks; ++b) {
    for (u32 lane = 0; lane < 16; ++lane) {
      const u32 id = spheres_[b].id[lane];
      if (id == kNone) continue;
      const ParamBlock& material = parhelion::baseline::material_of(view_, id);
      const Vec3 shine = with_material(material, color_of(view_, id, material),
                                       [](const auto& m) { return emitted(m); });
      const float weight = emitter_weight(primitive(spheres_[b], lane), shine);
      if (!(weight > 0.0f)) continue;
      total += static_cast<double>(weight);
      weights.push_back(total);
      emitters_.push_back({{make_leaf(ShapeKind::sphere, b), lane}, 0.0f});
    }
  }
  for (size_t i = 0; i < emitters_.size(); ++i) {
    emitters_[i].cumulative = static_cast<float>(weights[i] / total);
  }
  if (!emitters_.empty()) emitters_.back().cumulative = 1.0f;
  view_.emitters = emitters_.data();
  view_.emitter_count = static_cast<u32>(emitters_.size());
  view_.emitter_total = static_cast<float>(total);
}

size_t Scene::memory() const {
  return nodes_.capacity() * sizeof(Node) + spheres_.capacity() * sizeof(SphereBlock) +
         materials_.capacity() * sizeof(ParamBlock) + material_of_.capacity() * sizeof(u32) +
         color_of_.capacity() * sizeof(Vec3) + emitters_.capacity() * sizeof(Emitter);
}

}  // namespace parhelion
