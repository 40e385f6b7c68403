// What C++ tests of whole scenes share: spheres at random, of every material, and how they end.
#pragma once
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "../../core/random.h"
#include "../../host/errors.h"
#include "../../host/kernels.h"
#include "../../host/rays.h"
#include "../../host/render.h"
#include "../../host/scene.h"
#include "../../host/view.h"
#include "check.h"

namespace parhelion {

template <class F>
std::string message_of(F f) {
  try {
    f();
  } catch (const SceneError& e) {
    return e.what();
  }
  return "";
}

inline ParamBlock block(MaterialKind kind, std::vector<float> values) {
  ParamBlock b{};
  b.kind = static_cast<u32>(kind);
  for (size_t i = 0; i < values.size(); ++i) b.value[i] = values[i];
  return b;
}

inline LightInput light(LightKind kind, std::vector<float> values) {
  LightInput l{};
  l.record.block.kind = static_cast<u32>(kind);
  for (size_t i = 0; i < values.size(); ++i) l.record.block.value[i] = values[i];
  for (int k = 0; k < 3; ++k) l.record.to_world[4 * k] = 1.0f;
  return l;
}

inline constexpr TextureBinding kNoBinding = {kNone, 0, 0, 0, 0.0f, 0.0f};

inline MaterialRecord material(const ParamBlock& b, u32 own) {
  MaterialRecord m{};
  m.block = b;
  m.opacity = 1.0f;
  m.emission_texture = m.normal_map = m.bump_map = m.blend_first = m.blend_second = kNone;
  m.opacity_texture = m.blend_texture = kNoBinding;
  m.back = own;
  m.bump_scale = 1.0f;
  return m;
}

// A scene of shapes, and groups for instances before them, under a white sky.
inline SceneInput input_of(const GroupInput& shapes, const std::vector<ParamBlock>& blocks,
                           std::vector<GroupInput> groups = {}) {
  SceneInput input;
  input.groups = std::move(groups);
  input.groups.push_back(shapes);
  for (const ParamBlock& b : blocks) {
    input.materials.push_back(material(b, static_cast<u32>(input.materials.size())));
  }
  input.lights = {light(LightKind::constant, {1.0f, 1.0f, 1.0f})};
  return input;
}

// Spheres at random in a cube, of every material, one of them shining, over a ground.
struct Cloud {
  std::vector<double> centers, radii;
  std::vector<u32> material;

  explicit Cloud(size_t n) {
    u64 state = 1;
    const auto next = [&] {
      state = baseline::mix(state + 0x9e3779b97f4a7c15ull);
      return static_cast<double>(state >> 11) * 0x1p-53;
    };
    for (size_t i = 0; i < n; ++i) {
      for (int k = 0; k < 3; ++k) centers.push_back(next());
      radii.push_back(0.3 / std::cbrt(static_cast<double>(n)) * (0.2 + next()));
      material.push_back(static_cast<u32>(i % 14));
    }
    centers.insert(centers.end(), {0.5, -1000.0, 0.5});
    radii.push_back(1000.0);
    material.push_back(0);
  }

  ShapeInput group() const {
    ShapeInput s;
    s.name = "cloud";
    s.count = radii.size();
    s.arrays = {{"centers", centers.data(), true, false, 3},
                {"radii", radii.data(), true, false, 1}};
    s.material_of = material.data();
    return s;
  }

  static std::vector<ParamBlock> materials() {
    return {block(MaterialKind::diffuse, {0.7f, 0.5f, 0.3f}),
            block(MaterialKind::metal, {0.9f, 0.9f, 0.9f, 0.2f}),
            glass(0.0f),
            block(MaterialKind::emissive, {2.0f, 2.0f, 1.0f}),
            metal(0.4f, 0.3f, 0, 1),
            metal(0.3f, 0.0f, 1, 1),
            block(MaterialKind::plastic, {0.5f, 0.7f, 0.3f, 1, 1, 1, 1.5f, 0.3f, 1, 0, 1}),
            block(MaterialKind::emissive, {1.0f, 2.0f, 2.0f}),
            block(MaterialKind::principled,
                  {0.6f, 0.5f, 0.4f, 0.3f, 0.4f, 0.5f, 30,   1.5f, 1,    1,    1,   1, 0.5f,
                   0.3f, 0.5f, 0.1f, 1.4f, 0.2f, 0.2f, 0.2f, 0.6f, 0.3f, 1.3f, 400, 0}),
            glass(0.5f),
            metal(0.5f, 0.0f, 0, 0),
            block(MaterialKind::emissive, {2.0f, 1.0f, 2.0f}),
            block(MaterialKind::plastic, {0.5f, 0.7f, 0.3f, 1, 1, 1, 1.5f, 0, 0, 1, 0}),
            block(MaterialKind::principled,
                  {0.6f, 0.5f, 0.4f, 0.3f, 0.4f, 0, 0, 1.5f, 1, 1,    1,   1, 0,
                   0,    0,    0.1f, 1.4f, 0,    0, 0, 0.6f, 0, 1.3f, 400, 0})};
  }
  static ParamBlock metal(float roughness, float anisotropy, float distribution, float single) {
    return block(MaterialKind::conductor, {0.9f, 0.8f, 1, 0.2f, 0.9f, 1.1f, 3.9f, 2.4f, 2.2f,
                                           roughness, anisotropy, distribution, single});
  }
  static ParamBlock glass(float roughness) {
    return block(MaterialKind::dielectric,
                 {1, 1, 1, 1.5f, roughness, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0});
  }
};

inline RenderView make_view(const Scene& scene, u32 width, u32 height, SamplerKind sampler) {
  CameraInput camera{};
  camera = {{2.0, 1.2, 2.5}, {0.5, 0.4, 0.5}, {0, 1, 0}, 0.0, 40.0, 0.02, 0.0};
  camera.projection = "perspective";
  RenderView view = {make_camera(camera, width, height, scene.scale(), scene.view().bounds),
                     make_filter("blackman-harris", 0.0),
                     sampler,
                     7,
                     12,
                     true,
                     true,
                     Integrator::path,
                     kInfinity,
                     {std::nanf(""), 0.0f, 0.0f},
                     {}};
  view.width = width, view.height = height;
  return view;
}

// What rays meet, however far away, and whether they meet anything.
struct Answers {
  std::vector<Hit> hits;
  std::vector<bool> blocked;
};
inline Answers ask(const Scene& scene, const std::vector<Ray>& rays, bool tree,
                   const std::string& isa = "") {
  const size_t n = batches(rays.size());
  std::vector<RayBatch> batch(n);
  for (size_t i = 0; i < rays.size(); ++i) {
    RayBatch& b = batch[i / kBatch];
    const size_t k = i % kBatch;
    const Vec3 o = rays[i].origin, d = rays[i].direction;
    b.origin[0][k] = o.x, b.origin[1][k] = o.y, b.origin[2][k] = o.z;
    b.direction[0][k] = d.x, b.direction[1][k] = d.y, b.direction[2][k] = d.z;
    b.limit[k] = kInfinity;
    b.self.leaf[k] = rays[i].self.leaf, b.self.lane[k] = rays[i].self.lane;
    b.self.instance[k] = rays[i].self.instance;
    b.inward |= (rays[i].inward ? 1u : 0u) << k;
    b.lanes |= 1u << k;
  }
  std::vector<HitBatch> hits(n);
  std::vector<u32> met(n);
  kernels(isa).intersect(scene.view(), batch.data(), n, tree, hits.data());
  kernels(isa).occluded(scene.view(), batch.data(), n, tree, met.data());
  Answers answers;
  for (size_t i = 0; i < rays.size(); ++i) {
    answers.hits.push_back(hit_at(hits[i / kBatch], i % kBatch));
    answers.blocked.push_back((met[i / kBatch] >> i % kBatch & 1u) != 0);
  }
  return answers;
}

// What a program of tests returns in the end, without threads that sanitizers would take for lost.
inline int finished(const char* name) {
  release_threads();
  std::printf("%s tests: %d failed\n", name, failures);
  return failures == 0 ? 0 : 1;
}

}  // namespace parhelion
