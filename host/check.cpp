#include "check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <iterator>
#include <limits>

#include "errors.h"
#include "threads.h"

namespace parhelion {
namespace {

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.9g", x);
  return buffer;
}

[[noreturn]] void fail(const ShapeInput& s, const char* field, size_t i, const std::string& what) {
  throw SceneError("shape '" + s.name + "': " + field + "[" + std::to_string(i) + "] is " + what);
}

// The array of radii among a shape's arrays; null if it has none.
const Numbers* radii_of(const ShapeInput& s) {
  for (const Numbers& a : s.arrays) {
    if (std::strcmp(a.name, "radii") == 0) return &a;
  }
  return nullptr;
}

void check_color(const ShapeInput& s, size_t i, const ColorRange& range) {
  for (size_t k = 0; k < 3; ++k) {
    const float c = s.colors[3 * i + k];
    if (c >= range.low && c <= range.high) continue;
    fail(s, "colors", i,
         text(static_cast<double>(c)) + " in " + "rgb"[k] + "; the colour of " + range.material +
             " must lie in [" + text(range.low) + ", " + text(range.high) + "]");
  }
}

// Rows that the loops below visit: vertices of a mesh, else primitives.
size_t row_count(const ShapeInput& s) { return s.faces ? s.vertex_count : s.count; }

}  // namespace

SceneChecks::SceneChecks(const std::vector<MaterialRecord>& materials) {
  for (const MaterialRecord& m : materials) {
    switch (static_cast<MaterialKind>(m.block.kind)) {
#define MATERIAL(name, Type)                                                                   \
  case MaterialKind::name:                                                                     \
    colors_.push_back({baseline::Type::params[0].low, baseline::Type::params[0].high, #name}); \
    break;
#include "../core/materials.def"
#undef MATERIAL
    }
  }
}

// The loop only gathers, and looks for the culprit when there is one, so that it runs at the speed
// of memory.
double SceneChecks::extent(const ShapeInput& s) const {
  const size_t materials = colors_.size(), rows = row_count(s);
  if (!s.material_of && s.material >= materials) {
    throw SceneError("shape '" + s.name + "': material " + std::to_string(s.material) + " of " +
                     std::to_string(materials));
  }
  const Numbers* radii = radii_of(s);
  double extent = 0.0;
  bool sound = true;
#pragma omp parallel for reduction(max : extent) reduction(&& : sound) if (rows > kFewElements)
  for (size_t i = 0; i < rows; ++i) {
    double size = 0.0, radius = 0.0;
    for (const Numbers& a : s.arrays) {
      for (int k = 0; k < a.columns; ++k) {
        const double x = a.at(i, k);
        sound = sound && std::isfinite(x);
        if (&a == radii) {
          radius = std::max(radius, x);
          sound = sound && x > 0.0;
        } else {
          size = std::max(size, std::fabs(x));
        }
      }
    }
    extent = std::max(extent, size + radius);
  }
#pragma omp parallel for reduction(&& : sound) if (s.count > kFewElements)
  for (size_t i = 0; i < s.count; ++i) {
    const bool known = !s.material_of || s.material_of[i] < materials;
    sound = sound && known;
    if (s.faces) {
      for (size_t k = 0; k < 3; ++k) sound = sound && s.faces[3 * i + k] < s.vertex_count;
    }
    if (s.colors && known) {
      const ColorRange& range = colors_[s.material_of ? s.material_of[i] : s.material];
      for (size_t k = 0; k < 3; ++k) {
        const float c = s.colors[3 * i + k];
        sound = sound && c >= range.low && c <= range.high;
      }
    }
  }
  for (size_t i = 0; !sound && i < rows; ++i) {
    for (const Numbers& a : s.arrays) {
      for (int k = 0; k < a.columns; ++k) {
        const double x = a.at(i, k);
        if (&a == radii) {
          if (!std::isfinite(x) || !(x > 0.0)) {
            fail(s, a.name, i, text(x) + "; a radius must be finite and greater than 0");
          }
        } else if (!std::isfinite(x)) {
          fail(s, a.name, i, std::string("not finite: ") + "xyz"[k % 3] + " = " + text(x));
        }
      }
    }
  }
  for (size_t i = 0; !sound && i < s.count; ++i) {
    for (size_t k = 0; s.faces && k < 3; ++k) {
      const u32 v = s.faces[3 * i + k];
      if (v >= s.vertex_count) {
        fail(s, "faces", i,
             "vertex " + std::to_string(v) + "; the mesh has vertices 0 to " +
                 std::to_string(static_cast<long long>(s.vertex_count) - 1));
      }
    }
    if (s.material_of && s.material_of[i] >= materials) {
      fail(s, "material", i,
           std::to_string(s.material_of[i]) + "; the scene has materials 0 to " +
               std::to_string(materials - 1));
    }
    if (s.colors) check_color(s, i, colors_[s.material_of ? s.material_of[i] : s.material]);
  }
  if (!std::isfinite(extent)) {
    throw SceneError("shape '" + s.name + "': its coordinates are too large to add to its radii");
  }
  return extent;
}

void SceneChecks::sizes(const ShapeInput& s, double extent) const {
  constexpr double kSmallest = 1e-15;
  if (s.kind != ShapeKind::sphere) return;
  const Numbers& radii = *radii_of(s);
  const size_t count = radii.one ? std::min<size_t>(s.count, 1) : s.count;
  double least = extent;
#pragma omp parallel for reduction(min : least) if (count > kFewElements)
  for (size_t i = 0; i < count; ++i) least = std::min(least, radii.at(i, 0));
  if (least >= kSmallest * extent) return;
  for (size_t i = 0; i < count; ++i) {
    if (radii.at(i, 0) < kSmallest * extent) {
      fail(s, radii.name, i,
           text(radii.at(i, 0)) + ", but the scene reaches out to " + text(extent) +
               "; spheres of less than 1e-15 of that cannot be rendered with it");
    }
  }
}

std::vector<u32> SceneChecks::materials(const ShapeInput& s) const {
  if (!s.material_of) return {s.material};
  std::vector<u32> used;
  if (s.count <= kFewElements) {
    used.assign(s.material_of, s.material_of + s.count);
    std::sort(used.begin(), used.end());
    used.erase(std::unique(used.begin(), used.end()), used.end());
    return used;
  }
  std::vector<char> is_used(colors_.size());
#pragma omp parallel
  {
    std::vector<char> mine(colors_.size());
#pragma omp for nowait
    for (size_t i = 0; i < s.count; ++i) mine[s.material_of[i]] = 1;
#pragma omp critical(parhelion_materials)
    for (size_t i = 0; i < mine.size(); ++i) is_used[i] |= mine[i];
  }
  for (u32 i = 0; i < is_used.size(); ++i) {
    if (is_used[i]) used.push_back(i);
  }
  return used;
}

ColorRange SceneChecks::colors(const GroupInput& shapes) const {
  ColorRange all{-std::numeric_limits<float>::infinity(), std::numeric_limits<float>::infinity(),
                 "nothing"};
  const auto narrow = [&](u32 material) {
    const ColorRange& r = colors_[material];
    if (r.high < all.high) all.material = r.material;
    all.low = std::max(all.low, r.low);
    all.high = std::min(all.high, r.high);
  };
  for (const ShapeInput& s : shapes) {
    if (s.kind == ShapeKind::instance) continue;
    for (u32 m : materials(s)) narrow(m);
  }
  return all;
}

void SceneChecks::instances(const ShapeInput& s, const std::vector<ColorRange>& groups) const {
  if (s.group >= groups.size()) throw SceneError("shape '" + s.name + "': no such group of shapes");
  for (size_t i = 0; i < s.count; ++i) {
    if (s.colors) check_color(s, i, groups[s.group]);
    const double* m = s.transforms + 12 * i;
    for (int k = 0; k < 12; ++k) {
      if (!std::isfinite(m[k])) fail(s, "transforms", i, "not finite");
    }
    const double determinant = m[0] * (m[5] * m[10] - m[6] * m[9]) -
                               m[1] * (m[4] * m[10] - m[6] * m[8]) +
                               m[2] * (m[4] * m[9] - m[5] * m[8]);
    double size = 0.0;
    for (int k = 0; k < 12; ++k) {
      if (k % 4 != 3) size = std::max(size, std::fabs(m[k]));
    }
    if (!(std::fabs(determinant) > 1e-12 * size * size * size)) {
      fail(s, "transforms", i, "a matrix that flattens what it places; it cannot be inverted");
    }
  }
}

ParamSpan material_params(u32 kind) {
  switch (static_cast<MaterialKind>(kind)) {
#define MATERIAL(name, Type) \
  case MaterialKind::name: return {baseline::Type::params, std::size(baseline::Type::params)};
#include "../core/materials.def"
#undef MATERIAL
  }
  throw SceneError("a material of unknown kind");
}

ParamSpan light_params(u32 kind) {
  switch (static_cast<LightKind>(kind)) {
#define LIGHT(name, Type) \
  case LightKind::name: return {baseline::Type::params, std::size(baseline::Type::params)};
#include "../core/lights.def"
#undef LIGHT
  }
  throw SceneError("a light of unknown kind");
}

void scale_lengths(ParamBlock& block, ParamSpan params, double scale) {
  size_t at = 0;
  for (size_t i = 0; i < params.count; ++i) {
    const ParamInfo& p = params.first[i];
    const double factor = std::pow(scale, p.length_power);  // exact: scale is a power of two
    for (int k = 0; k < p.size; ++k, ++at) {
      block.value[at] = static_cast<float>(static_cast<double>(block.value[at]) * factor);
    }
  }
}

}  // namespace parhelion
