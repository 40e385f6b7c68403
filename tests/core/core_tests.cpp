// Tests of core and host without Python, for the sanitizers to watch: every kernel, every
// instruction set, builds and renders on several threads, stops and errors.
#include <omp.h>
#if defined(__linux__)
#include <sched.h>
#endif

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "../../core/material.h"
#include "../../core/packet.h"
#include "../../host/bins.h"
#include "../../host/errors.h"
#include "../../host/kernels.h"
#include "../../host/partition.h"
#include "../../host/render.h"
#include "../../host/samples.h"
#include "../../host/scene.h"
#include "../../host/tree_cost.h"
#include "../../host/view.h"
#include "../../host/wake_apart.h"
#include "check.h"

namespace {

using namespace parhelion;

template <class F>
std::string message_of(F f) {
  try {
    f();
  } catch (const SceneError& e) {
    return e.what();
  }
  return "";
}

ParamBlock block(MaterialKind kind, std::vector<float> values) {
  ParamBlock b{};
  b.kind = static_cast<u32>(kind);
  for (size_t i = 0; i < values.size(); ++i) b.value[i] = values[i];
  return b;
}

LightInput light(LightKind kind, std::vector<float> values) {
  LightInput l{};
  l.record.block.kind = static_cast<u32>(kind);
  for (size_t i = 0; i < values.size(); ++i) l.record.block.value[i] = values[i];
  for (int k = 0; k < 3; ++k) l.record.to_world[4 * k] = 1.0f;
  return l;
}

constexpr TextureBinding kNoBinding = {kNone, 0, 0, 0, 0.0f, 0.0f};

MaterialRecord material(const ParamBlock& b, u32 own) {
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
SceneInput input_of(const GroupInput& shapes, const std::vector<ParamBlock>& blocks,
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

RenderView make_view(const Scene& scene, u32 width, u32 height, SamplerKind sampler) {
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

// Every cell's target.
Targets all_to(const Film& film, u32 samples) {
  return {std::vector<u32>(size_t{film.cells_across()} * film.cells_down(), samples)};
}

bool same(const Film& a, const Film& b) {
  return std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(FilmPixel)) == 0;
}

const Tick kNever = [](u64, u64) { return false; };

void pictures_do_not_depend_on_how_they_are_made(bool reuse_paths) {
  const Cloud cloud(6000);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  CHECK(scene.light_count() == 1286 && !scene.view().has_holes);
  for (SamplerKind sampler : {SamplerKind::sobol, SamplerKind::independent}) {
    RenderView view = make_view(scene, 40, 24, sampler);
    view.reuse_paths = reuse_paths;
    Film reference(0, 0, 40, 24);
    render_pass(kernels("baseline"), scene, view, reference, all_to(reference, 4),
                {1, 16, Schedule::dynamic_}, kNever);
    for (const std::string& isa : instruction_sets()) {
      for (Schedule schedule : {Schedule::dynamic_, Schedule::static_, Schedule::guided}) {
        Film film(0, 0, 40, 24);
        Targets targets = all_to(film, 3);
        targets.samples[4] = 0, targets.samples[7] = 1;  // of 5 x 6 cells, 32 pixels each
        render_pass(kernels(isa), scene, view, film, targets, {3, 7, schedule}, kNever);
        const PassResult r = render_pass(kernels(isa), scene, view, film, all_to(film, 4),
                                         {2, 16, schedule}, kNever);
        CHECK(r.complete && r.samples == 40 * 24 + 32 * 5 && r.rays >= r.samples);
        CHECK(same(reference, film));
        if (reuse_paths) continue;  // samples are not rendered by themselves
        Film later(0, 0, 40, 24);
        later.begin(std::vector<u32>(later.pixels.size(), 1));
        render_pass(kernels(isa), scene, view, later, all_to(later, 4), {3, 7, schedule}, kNever);
        for (u32 i = 0; i < later.pixels.size(); ++i) {  // the first sample is all that it lacks
          --later.pixels[i].count;
          baseline::add(later.pixels[i],
                        kernels(isa).radiance(scene.view(), view, i % 40, i / 40, 0));
          baseline::carry(later.pixels[i]);
        }
        CHECK(same(reference, later));
      }
    }
    RenderView brute = view;
    brute.tree = false;
    Film film(0, 0, 40, 24);
    render_pass(kernels(), scene, brute, film, all_to(film, 4), {2, 16, Schedule::dynamic_},
                kNever);
    CHECK(same(reference, film));
    Film crop(10, 5, 9, 8);
    render_pass(kernels(), scene, view, crop, all_to(crop, 4), {2, 4, Schedule::dynamic_}, kNever);
    for (u32 y = 0; y < 8; ++y) {
      CHECK(std::memcmp(&crop.pixels[y * 9], &reference.pixels[(y + 5) * 40 + 10],
                        9 * sizeof(FilmPixel)) == 0);
    }
    RenderView other = view;
    other.reuse_paths = !reuse_paths;
    render_pass(kernels(), scene, other, film, all_to(film, 8), {2, 16, Schedule::dynamic_},
                kNever);
    render_pass(kernels(), scene, view, reference, all_to(reference, 8),
                {2, 16, Schedule::dynamic_}, kNever);
    CHECK(!same(reference, film));
    // Films of two kinds, and of other sizes, in one pass.
    Film part(10, 5, 9, 8), rest(0, 0, 40, 24);
    const Targets few = all_to(part, 4), all = all_to(rest, 8);
    const Part parts[] = {{view, part, few}, {other, rest, all}};
    const PassResult both =
        render_pass(kernels(), scene, parts, {3, 7, Schedule::dynamic_}, kNever);
    CHECK(both.complete && both.samples == 9 * 8 * 4 + 40 * 24 * 8);
    CHECK(same(part, crop));
    Film alone(0, 0, 40, 24);
    render_pass(kernels(), scene, other, alone, all, {2, 16, Schedule::dynamic_}, kNever);
    CHECK(same(rest, alone));
  }
}

// Lines that meet a tree's box, all equally likely, and the boxes within that they meet.
void trees_cost_what_lines_meet() {
  using namespace baseline;
  const Cloud cloud(3000);
  ShapeInput spheres = cloud.group();
  --spheres.count;  // without the ground
  const Scene scene(input_of({spheres}, Cloud::materials()));
  const SceneView view = scene.view();
  Node whole = view.nodes[view.root];  // the box around all of the root's
  for (u32 k = 0; k < 3; ++k) {
    whole.low[k][0] = *std::min_element(whole.low[k], whole.low[k] + 16);
    whole.high[k][0] = *std::max_element(whole.high[k], whole.high[k] + 16);
  }
  const auto corner = [&](const float (&of)[3][16]) { return Vec3{of[0][0], of[1][0], of[2][0]}; };
  const Vec3 middle = (corner(whole.low) + corner(whole.high)) * 0.5f;
  const float radius = length(corner(whole.high) - middle);
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  const auto on_ball = [&] {
    const Vec3 v = {normal(random), normal(random), normal(random)};
    return middle + normalize(v) * radius;
  };
  u64 lines = 0, nodes = 0, leaves = 0;
  for (u32 i = 0; i < 40'000; ++i) {
    // Through two points at random on a ball, which makes no line likelier than another.
    const Vec3 from = on_ball();
    const Slabs slabs = slabs_of(from, on_ball() - from);
    const auto met = [&](const Node& node) {
      Lanes near;
      return test_boxes(node, slabs, kInfinity, near);
    };
    if ((met(whole) & 1u) == 0) continue;
    ++lines;
    std::vector<Child> left = {view.root};
    while (!left.empty()) {
      const Child child = left.back();
      left.pop_back();
      ++((child & kLeafBit) != 0 ? leaves : nodes);
      if ((child & kLeafBit) != 0) continue;
      const Node& node = view.nodes[child];
      for_each_bit(met(node), [&](u32 k) { left.push_back(node.child[k]); });
    }
  }
  const TreeCost cost = tree_cost(view);
  const auto close = [&](u64 counted, double expected) {
    return std::abs(static_cast<double>(counted) / static_cast<double>(lines) / expected - 1.0) <
           0.02;
  };
  CHECK(lines > 10'000 && close(nodes, cost.nodes) && close(leaves, cost.leaves));
  CHECK(tree_cost(Scene(input_of({}, {})).view()).nodes == 0.0);
}

// One path at a time, each ray is a walk, and each of them is counted among those that are timed,
// also where rays pass holes.
void every_walk_is_counted() {
  const Cloud cloud(300);
  for (float opacity : {1.0f, 0.6f}) {
    SceneInput input = input_of({cloud.group()}, Cloud::materials());
    for (MaterialRecord& m : input.materials) m.opacity = opacity;
    const Scene scene(std::move(input));
    const RenderView view = make_view(scene, 16, 9, SamplerKind::sobol);
    u64 timed = 0;
    for (u32 i = 0; i < 16 * 9; ++i) {
      PathStats stats;
      stats.walks = kTimedWalks - 1;  // the next is timed
      baseline::radiance(scene.view(), view, i % 16, i / 16, 0, stats);
      const u64 walked = stats.walks - (kTimedWalks - 1);
      CHECK(walked == stats.rays || (walked == 0 && stats.rays == 1));  // it passes the scene by
      timed += stats.timed_ticks;
    }
    CHECK(timed > 0 || compiler::ticks() == 0);
  }
}

// What is rendered in batches, which end in the middle of rows and pixels, is the sum of samples
// that are rendered by themselves; of pixels outside of what is asked for nothing changes.
void batches_are_their_samples() {
  const Cloud cloud(300);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const RenderView view = make_view(scene, 13, 3, SamplerKind::sobol);
  for (const std::string& isa : instruction_sets()) {
    const Kernels& k = kernels(isa);
    for (u32 last : {2u, 3u, 9u, 35u}) {
      std::vector<FilmPixel> row(13);
      PathStats stats;
      k.render_row(scene.view(), view, 1, 2, 12, 2, last, &row[2], nullptr, stats);
      for (u32 x = 0; x < 13; ++x) {
        FilmPixel sum{};
        for (u32 s = 2; s < last && x >= 2 && x < 12; ++s) {
          baseline::add(sum, k.radiance(scene.view(), view, x, 1, s));
        }
        baseline::carry(sum);
        CHECK(std::memcmp(&sum, &row[x], sizeof sum) == 0);
      }
    }
  }
}

void samples_that_are_not_finite_are_counted_and_left_out() {
  const float odd[4] = {std::nanf(""), kInfinity, -kInfinity, 1e38f};
  float rgb[3][8];
  u32 at[8];
  FilmPixel one_by_one[2] = {}, together[2] = {};
  for (u32 i = 0; i < 8; ++i) {
    for (u32 k = 0; k < 3; ++k) rgb[k][i] = i < 4 && i % 3 == k ? odd[i] : 0.1f * (i + k) - 0.2f;
    at[i] = i / 3 % 2;
    if (i < 7) baseline::add(one_by_one[at[i]], Vec3{rgb[0][i], rgb[1][i], rgb[2][i]});
  }
  baseline::add(together, at, rgb, 7);
  CHECK(std::memcmp(one_by_one, together, sizeof together) == 0);
  CHECK(together[0].bad + together[1].bad == 3);
}

void rays_meet_the_same_through_the_tree_and_without() {
  for (size_t n : {0, 1, 15, 16, 17, 300, 20000}) {
    const Cloud cloud(n);
    const Scene scene(input_of({cloud.group()}, Cloud::materials()));
    std::vector<Ray> rays;
    const float scale = static_cast<float>(scene.scale());
    for (u32 i = 0; i < 500; ++i) {
      const auto s = baseline::make_sampler(SamplerKind::independent, 1, 2, i, 3);
      const Vec2 a = baseline::draw2(s, 0), b = baseline::draw2(s, 1);
      rays.push_back({{a.x * scale, a.y * scale, b.x * scale},
                      baseline::uniform_sphere(baseline::draw2(s, 2)),
                      kNoSlot,
                      false});
    }
    const std::vector<float> limit(rays.size(), kInfinity);
    std::vector<Hit> tree(rays.size()), brute(rays.size());
    std::vector<u8> blocked(rays.size());
    for (const std::string& isa : instruction_sets()) {
      kernels(isa).intersect(scene.view(), rays.data(), limit.data(), rays.size(), true,
                             tree.data());
      kernels(isa).intersect(scene.view(), rays.data(), limit.data(), rays.size(), false,
                             brute.data());
      kernels(isa).occluded(scene.view(), rays.data(), limit.data(), rays.size(), true,
                            blocked.data());
      for (size_t i = 0; i < rays.size(); ++i) {
        const bool hit = tree[i].slot.leaf != kNone;
        CHECK(tree[i].t == brute[i].t && tree[i].slot.leaf == brute[i].slot.leaf &&
              tree[i].slot.lane == brute[i].slot.lane);
        CHECK(hit == (blocked[i] != 0));
      }
    }
  }
}

// As those of a camera do: some lanes of sixteen, from one point or many, at angles from none to
// such that signs differ, along axes too. And those that begin together and go their own ways.
void rays_together_meet_what_each_meets() {
  using namespace baseline;
  int behind = 0;
  for (size_t n : {1, 17, 300, 20000}) {
    const Cloud cloud(n);
    // Through each sphere a triangle that reaches out of it, twice, of which the first counts.
    std::vector<double> corners;
    std::vector<u32> faces;
    for (u32 i = 0; i < n; ++i) {
      const double *c = cloud.centers.data() + 3 * i, r = 1.5 * cloud.radii[i];
      corners.insert(corners.end(), {c[0] - r, c[1], c[2] - 0.4 * r, c[0] + r, c[1] + r, c[2], c[0],
                                     c[1] - r, c[2] + r});
    }
    for (u32 i = 0; i < 6 * n; ++i) faces.push_back(i % static_cast<u32>(3 * n));
    ShapeInput mesh;
    mesh.kind = ShapeKind::triangle;
    mesh.name = "mesh";
    mesh.count = 2 * n;
    mesh.vertex_count = 3 * n;
    mesh.faces = faces.data();
    mesh.arrays = {{"vertices", corners.data(), true, false, 3}};
    const Scene scene(input_of({cloud.group(), mesh}, Cloud::materials()));
    const float scale = static_cast<float>(scene.scale());
    int bounded = 0, narrow = 0, wide = 0, met = 0, flat = 0;
    for (u32 i = 0; i < 400; ++i) {
      const auto s = make_sampler(SamplerKind::independent, 1, 2, i, 5);
      const float spread = i % 4 == 0 ? 0.0f : i % 4 == 1 ? 1e-4f : i % 4 == 2 ? 0.05f : 1.5f;
      const u32 lanes = i % 3 == 0 ? 0xffffu : reverse_bits(i * 0x9e3779b9u) >> 16 | 1u;
      const Vec2 a = draw2(s, 0), b = draw2(s, 1);
      const Vec3 middle =
          i % 7 == 0 ? Vec3{0, i % 2 ? -1.0f : 1.0f, 0} : uniform_sphere(draw2(s, 2));
      Rows<Vec3, kBatch> origin, direction;
      for (u32 k = 0; k < kBatch; ++k) {
        const Vec3 way = uniform_sphere(draw2(s, 3 + k));
        origin.set(k, Vec3{a.x, a.y, b.x} * scale + way * (i % 5 == 0 ? 0.1f * scale : 0.0f));
        direction.set(k, normalize(middle + way * spread));
      }
      float t[kBatch], t_apart[kBatch];
      SlotRows<kBatch> slot, slot_apart;
      intersect_close(scene.view(), origin, direction, lanes, t, slot);
      Bundle bundle;
      if (bundle_of(origin, direction, lanes, bundle)) {
        ++bounded;
        for (size_t node = 0; node < scene.node_count(); ++node) {
          const Node& over = scene.view().nodes[node];
          alignas(64) float near[16];
          Lanes first;
          const u32 hits = test_boxes(over, bundle, kInfinity, first);
          store(near, first);
          for_each_bit(hits, [&](u32 lane) {
            ++(is_narrow(over, lane, bundle, near[lane]) ? narrow : wide);
          });
        }
      }
      const auto ray_at = [&](u32 k) { return Ray{origin.at(k), direction.at(k), kNoSlot, false}; };
      intersect_each(scene.view(), direction, lanes, ray_at, true, t_apart, slot_apart);
      // And whether anything but the nearest is met before that, or not much farther away.
      float limit[kBatch];
      for_each_bit(lanes, [&](u32 k) { limit[k] = t[k] * (k % 2 ? 1.5f : 1.0f); });
      const u32 hidden = occluded_each(
          scene.view(), direction, lanes, ray_at, limit, [&](u32 k) { return slot.at(k); }, true);
      for_each_bit(lanes, [&](u32 k) {
        Hit alone;
        met += intersect(scene.view(), ray_at(k), kInfinity, true, alone) ? 1 : 0;
        if (alone.slot.leaf != kNone && leaf_kind(alone.slot.leaf) == ShapeKind::triangle) {
          const auto& block = scene.view().triangles[alone.slot.leaf & kLeafIndexMask];
          CHECK(block.id[alone.slot.lane] < cloud.radii.size() + n);
          ++flat;
        }
        for (const Hit& one : {Hit{t[k], slot.at(k)}, Hit{t_apart[k], slot_apart.at(k)}}) {
          CHECK(one.t == alone.t && one.slot.leaf == alone.slot.leaf &&
                one.slot.lane == alone.slot.lane && one.slot.instance == alone.slot.instance);
        }
        const bool other = occluded(scene.view(), ray_at(k), limit[k], slot.at(k), true);
        CHECK((hidden >> k & 1u) == (other ? 1u : 0u));
        behind += other ? 1 : 0;
      });
    }
    CHECK(bounded > 150 && bounded < 390 && met > 400 && (n == 1 || flat > 100));
    CHECK(wide > 50 && (n < 300 || narrow > 50));
  }
  CHECK(behind > 400);
}

// Sixteen rays close to each other, as of a camera with a lens or without.
struct Rays {
  baseline::Rows<Vec3, baseline::kBatch> origin, direction;

  explicit Rays(u32 i, const baseline::Sampler& s) {
    using namespace baseline;
    const float spread = i % 4 == 0 ? 1e-6f : i % 4 == 1 ? 1e-3f : i % 4 == 2 ? 0.02f : 0.3f;
    const float lens = i % 3 == 0 ? 0.0f : i % 3 == 1 ? 1e-4f : 0.02f;
    const Vec3 from = uniform_sphere(draw2(s, 0)) * 0.9f;
    const Vec3 ways[3] = {{1.0f, 0.7f, 0.6f}, {-0.6f, -1.0f, 0.7f}, {0.6f, -0.7f, 1.0f}};
    const Vec3 middle = normalize(ways[i % 5 % 3] + uniform_sphere(draw2(s, 1)) * 0.2f);
    for (u32 k = 0; k < kBatch; ++k) {
      const Vec3 way = uniform_sphere(draw2(s, 2 + k));
      origin.set(k, from + way * lens);
      direction.set(k, normalize(middle + way * spread));
    }
  }
  Ray at(u32 k) const { return {origin.at(k), direction.at(k), kNoSlot, false}; }
};

// What a bundle says its rays may meet of a block, and what each of them meets.
struct Met {
  int bundles = 0, hits = 0, left_out = 0;  // bundles: others' rays run fastest along several axes

  template <class Block>
  void look(const Rays& rays, const Block& block, u32 unused) {
    using namespace baseline;
    Bundle bundle = {};
    const bool bounded = bundle_of(rays.origin, rays.direction, 0xffff, bundle);
    bool same = true;
    for (u32 k = 0; k < kBatch; ++k) {
      const int along = shear_along(rays.direction.at(k)).z;
      same = same && along == shear_along(rays.direction.at(0)).z;
      CHECK(!bounded || along == bundle.along);
    }
    CHECK(bounded == same);
    if (!bounded) return;
    ++bundles;
    for (const float limit : {kInfinity, 0.5f}) {
      float limits[kBatch], one[16][kBatch];
      for (u32 k = 0; k < kBatch; ++k) limits[k] = k % 5 == 4 ? 0.0f : k % 3 == 2 ? 0.1f : limit;
      for (u32 j = 0; j < 16; ++j) {
        if (!intersect_rays(primitive(block, j), rays.origin, rays.direction, bundle.along, limits,
                            one[j])) {
          std::fill(one[j], one[j] + kBatch, 0.0f);
        }
      }
      const u32 may = intersect_bundle(block, bundle, limit);
      CHECK((may >> unused & 1u) == 0);
      left_out += 15 - std::popcount(may);
      for (u32 k = 0; k < kBatch; ++k) {
        float t[16];
        const Ray ray = rays.at(k);
        const u32 met = intersect(block, ray, limits[k], kNone, t);
        CHECK((met & ~may) == 0);
        hits += std::popcount(met);
        for (u32 j = 0; j < 16; ++j) {
          CHECK((met >> j & 1u) == (one[j][k] > 0.0f && one[j][k] <= limits[k] ? 1u : 0u));
          if ((met >> j & 1u) != 0) CHECK(one[j][k] == t[j]);
        }
      }
    }
  }
};

// Primitives of all sizes that a bundle's rays graze, miss closely, start in and leave behind.
void bundles_meet_what_their_rays_meet() {
  using namespace baseline;
  Met spheres, triangles;
  for (u32 i = 0; i < 4000; ++i) {
    const auto s = make_sampler(SamplerKind::independent, 3, 1, i, 7);
    const Rays rays(i, s);
    SphereBlock round = {};
    TriangleBlock flat = {};
    for (u32 k = 0; k < 16; ++k) {
      const Vec2 a = draw2(s, 20 + k), b = draw2(s, 40 + k);
      const Vec3 o = rays.origin.at(k), d = rays.direction.at(k);
      const Vec3 aside = frame_along(d, uniform_sphere(draw2(s, 60 + k))).x;
      const float size = std::exp(-14.0f * a.x), along = 2.0f * a.y - 0.4f;
      const float near = b.x < 0.5f ? 1.0f + (b.y - 0.5f) * 1e-5f : 4.0f * b.y;  // of its radius
      const Vec3 center = o + d * along + aside * (size * near);
      round.x[k] = center.x, round.y[k] = center.y, round.z[k] = center.z;
      round.radius[k] = size, round.id[k] = k;
      // Needles, too, and of some a vertex or an edge on the ray.
      const float thin = k % 3 == 0 ? 1e-3f : 1.0f;
      Vec3 corner[3] = {center, center + uniform_sphere(draw2(s, 80 + k)) * size,
                        center + uniform_sphere(draw2(s, 100 + k)) * (size * thin)};
      if (k % 4 == 1) corner[0] = o + d * along;
      if (k % 4 == 2) corner[1] = corner[0] - aside * (2.0f * size);
      if (k % 8 == 3) {  // from a corner on, the others behind it
        corner[0] = o - d * size + aside * (size * near);
        corner[1] = o;
        corner[2] = o - d * (2.0f * size) + uniform_sphere(draw2(s, 100 + k)) * size;
      }
      if (k % 8 == 7) {  // along the ray, from behind its origin on
        corner[0] = o + d * along + aside * (size * 1e-6f);
        corner[1] = o - d * (2.0f * a.y);
        corner[2] = o + d * size - aside * (size * 1e-6f);
      }
      for (u32 c = 0; c < 3; ++c) {
        flat.vertex[c][0][k] = corner[c].x, flat.vertex[c][1][k] = corner[c].y;
        flat.vertex[c][2][k] = corner[c].z;
      }
      flat.id[k] = k;
    }
    const u32 unused = i % 16;
    const float none = std::numeric_limits<float>::quiet_NaN();
    round.x[unused] = round.y[unused] = round.z[unused] = none;
    for (auto& corner : flat.vertex) {
      for (auto& axis : corner) axis[unused] = none;
    }
    spheres.look(rays, round, unused);
    triangles.look(rays, flat, unused);
  }
  CHECK(spheres.bundles > 3000 && spheres.bundles < 4000 && triangles.bundles == spheres.bundles);
  CHECK(spheres.hits > 80000 && spheres.left_out > 20000);
  CHECK(triangles.hits > 30000 && triangles.left_out > 20000);
}

// From both ends to the middle, and to an end if the number of the first is not what it should be.
void partitions_keep_their_order() {
  for (u32 n : {0u, 1u, 2u, 63u, 64u, 65u, 128u, 1000u}) {
    for (u32 share = 0; share <= 8; ++share) {
      std::vector<u32> own(n), plain;
      for (u32 i = 0; i < n; ++i) own[i] = static_cast<u32>(baseline::mix(i + 1000u * share));
      const auto first = [&](u32 a) { return (a & 7u) < share; };
      plain = own;
      size_t from = 0, to = n;
      for (;;) {
        while (from < to && first(plain[from])) ++from;
        while (from < to && !first(plain[to - 1])) --to;
        if (from == to) break;
        std::swap(plain[from], plain[to - 1]);
      }
      partition(own.data(), own.data() + from, own.data() + n, first);
      CHECK(own == plain);
      partition(own.data(), own.data() + n / 2, own.data() + n,
                [](u32 a) { return (a & 8u) != 0; });
      std::sort(own.begin(), own.end());
      std::sort(plain.begin(), plain.end());
      CHECK(own == plain);
    }
  }
}

// The same halves as by one thread, each in the order that it had. Of boxes about one point there
// are none.
void several_threads_divide_as_one_does() {
  const auto alike = [](const Extent& a, const Extent& b) {
    const Aabb one = a.box(), other = b.box();
    return std::memcmp(&one, &other, sizeof one) == 0;
  };
  for (const size_t n : {size_t{20000}, size_t{100003}, size_t{600000}}) {
    std::vector<Ref> refs(n), spare(n);
    for (u32 i = 0; i < n; ++i) {
      for (u32 k = 0; k < 3; ++k) {
        const float at =
            static_cast<float>(static_cast<u32>(baseline::mix(3 * i + k)) >> 8) * 0x1p-24f;
        refs[i].low[k] = at * at * at, refs[i].high[k] = refs[i].low[k] + 1e-3f * at;
      }
      refs[i].id = i;
    }
    const std::vector<Ref> before = refs;
    tree::Part left, right, one_left, one_right;
    const tree::Part whole = tree::measure(refs.data(), n);
    bool divided = false;
#pragma omp parallel num_threads(3)
#pragma omp single
    divided = tree::split_by_tasks(whole, spare.data(), left, right);
    CHECK(divided && left.refs == spare.data() && right.refs == spare.data() + left.size);
    tree::split(whole, one_left, one_right);
    CHECK(left.size == one_left.size && right.size == one_right.size && left.size > 0);
    CHECK(alike(left.box, one_left.box) && alike(left.centers, one_left.centers));
    CHECK(alike(right.box, one_right.box) && alike(right.centers, one_right.centers));
    std::vector<bool> is_left(n, false);
    for (size_t i = 0; i < left.size; ++i) is_left[one_left.refs[i].id] = true;
    size_t next_left = 0, next_right = left.size;
    for (u32 i = 0; i < n; ++i) {
      CHECK(std::memcmp(&spare[is_left[i] ? next_left++ : next_right++], &before[i], sizeof(Ref)) ==
            0);
    }
    const Extent point = tree::measure(refs.data(), 1).centers;
    CHECK(!tree::split_by_tasks({refs.data(), n, whole.box, point}, spare.data(), left, right));
  }
}

// Even numbers that have chosen a lobe are even ones for its directions, in [0, 1).
void lobes_share_even_numbers() {
  for (const float chance : {0.0f, 1e-3f, 0.3f, 0.5f, 0.99f, 1.0f}) {
    const u32 n = 4096;
    float expected[2] = {0.0f, 0.0f}, widest = 0.0f;
    u32 count[2] = {0, 0};
    for (u32 i = 0; i < n; ++i) {
      Vec2 u = {(static_cast<float>(i) + 0.5f) / n, 0.25f};
      const u32 lobe = baseline::first_lobe(chance, 1.0f - chance, u) ? 0 : 1;
      const float step = 1.0f / (n * (lobe == 0 ? chance : 1.0f - chance));
      if (count[lobe]++ == 0) {
        CHECK(u.x <= step);
        expected[lobe] = u.x;
      }
      CHECK(u.x >= 0.0f && u.x < 1.0f && u.y == 0.25f);
      widest = std::max(widest, std::abs(u.x - expected[lobe]) / step);
      expected[lobe] += step;
    }
    CHECK(widest < 0.5f);
    CHECK(std::abs(static_cast<float>(count[0]) - n * chance) <= 1.0f);
  }
  // Nor does rounding make 1 of the largest.
  for (u32 i = 0; i <= 2000; ++i) {
    const float chance = static_cast<float>(i) / 2000.0f;
    for (const float x : {0.0f, 1.0f - 0x1p-24f}) {
      Vec2 u = {x, 0.0f};
      baseline::first_lobe(chance, 1.0f - chance, u);
      CHECK(u.x >= 0.0f && u.x < 1.0f);
    }
  }
}

template <class Form>
baseline::BsdfValue value_plainly(const Form& form, Vec3 wo, Vec3 wi) {
  if constexpr (baseline::NeedsTables<Form>) {
    const auto seen = from(form, place_from(form, wo));
    return evaluate(form, seen, to(form, place_to(form, wi)), wo, wi);
  } else {
    return value_of(form.whole(), wo, wi);
  }
}
template <class Form>
bool sample_plainly(const Form& form, Vec3 wo, const baseline::BsdfDraws& u,
                    baseline::BsdfSample& out) {
  if constexpr (baseline::NeedsTables<Form>) {
    const auto seen = from(form, place_from(form, wo));
    Vec3 wi;
    return choose(form, pick(lobes(form, seen), u.direction), wo, wi) &&
           weigh_sample(form, seen, to(form, place_to(form, wi)), wo, wi, out);
  } else {
    return sample(form.whole(), wo, u, out);
  }
}

// What a material's plain form says is what the material says, to the bit.
template <class Material, class Form>
void plain_is_the_whole(const std::vector<ParamBlock>& blocks) {
  using namespace baseline;
  for (const ParamBlock& b : blocks) {
    const Material m = from_block<Material>(b);
    u32 fitting = 0;
    for_each_plain_form<Material>([&]<class Each>(u32) { fitting += Each::fits(m) ? 1 : 0; });
    CHECK(Form::fits(m) && fitting == 1);
    const Form form = Form::of(m);
    for (u32 i = 0; i < 2000; ++i) {
      const auto s = make_sampler(SamplerKind::independent, 1, 2, i, 9);
      Vec3 wo = uniform_sphere(draw2(s, 0)), wi = uniform_sphere(draw2(s, 1));
      Vec2 u = draw2(s, 2);
      if (i % 8 == 0) wo = normalize(Vec3{wo.x, wo.y, 1e-3f});
      if (i % 16 == 0) wi = normalize(Vec3{-wo.x, -wo.y, 1e-3f});
      if (i % 32 == 1) wo = normalize(Vec3{wo.x, wo.y, 0.0f});
      if (i % 32 == 2) wi = normalize(Vec3{wi.x, wi.y, 0.0f});
      if (i % 5 == 0) u.x = i % 2 == 0 ? 0.0f : 1.0f - 0x1p-24f;
      if (i % 7 == 0) u.y = i % 2 == 0 ? 0.0f : 1.0f - 0x1p-24f;
      const BsdfDraws draws = {u, draw1(s, 3)};
      BsdfSample one = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false}, other = one;
      const bool is = sample(m, wo, draws, one);
      CHECK(is == sample_plainly(form, wo, draws, other));
      CHECK(!is || std::memcmp(&one, &other, offsetof(BsdfSample, delta)) == 0);
      CHECK(!is || (one.delta == other.delta && finite(one.wi) && finite(one.weight)));
      const BsdfValue value = value_of(m, wo, wi), plainly = value_plainly(form, wo, wi);
      CHECK(finite(value.value) && finite(value.pdf));
      CHECK(std::memcmp(&value, &plainly, sizeof value) == 0);
    }
  }
}

// Plastic's blocks with what is worked out of them, which plain forms keep and whose values it does
// not change.
template <class Form>
std::vector<ParamBlock> derived(std::vector<ParamBlock> blocks) {
  using namespace baseline;
  const Vec3 wo = normalize(Vec3{0.3f, -0.4f, 0.5f}), wi = normalize(Vec3{0.1f, 0.7f, 0.2f});
  for (ParamBlock& b : blocks) {
    const Plastic one = from_block<Plastic>(b);
    Plastic other = one;
    derive(other);
    CHECK(one.inside == 0.0f && (other.inside > 0.0f || one.ior == 1.0f));
    CHECK(Form::of(other).whole().inside == other.inside);
    const BsdfValue u = value_of(one, wo, wi), v = value_of(other, wo, wi);
    CHECK(std::memcmp(&u, &v, sizeof u) == 0);
    other.ior += 0.25f;  // whoever changes one has it worked out anew
    derive(other);
    CHECK(other.inside == thrown_back(other, coat(other)));
    to_block(other, b);
  }
  return blocks;
}

void plain_materials_are_the_whole() {
  using namespace baseline;
  plain_is_the_whole<Diffuse, PlainDiffuse>(
      {block(MaterialKind::diffuse, {0.7f, 0.5f, 0.3f, 0.0f})});
  plain_is_the_whole<Metal, Metal>({block(MaterialKind::metal, {0.7f, 0.5f, 0.3f, 0.0f}),
                                    block(MaterialKind::metal, {0.7f, 0.5f, 0.3f, 0.4f}),
                                    block(MaterialKind::metal, {1.0f, 1.0f, 1.0f, 1.0f})});
  const auto metal = Cloud::metal;
  plain_is_the_whole<Conductor, PlainConductor<Facets::ggx>>(
      {metal(0.3f, 0.0f, 0, 1), metal(0.9f, -0.7f, 0, 1), metal(0.0f, 0.0f, 0, 0),
       metal(0.0101f, 0.0f, 0, 1), metal(1.0f, 0.99f, 0, 1)});
  plain_is_the_whole<Conductor, PlainConductor<Facets::beckmann>>(
      {metal(0.3f, 0.0f, 1, 1), metal(0.9f, -0.7f, 1, 1), metal(0.0f, 0.0f, 1, 0),
       metal(0.0101f, 0.0f, 1, 1), metal(1.0f, 0.99f, 1, 1)});
  for_each_plain_form<Conductor>([&]<class Form>(u32) {
    CHECK(!Form::fits(from_block<Conductor>(metal(0.3f, 0.0f, 0, 0))));
    CHECK(!Form::fits(from_block<Conductor>(metal(0.3f, 0.0f, 1, 0))));
  });
  const auto principled = [](float metallic, float roughness, float ior, float specular) {
    Principled m{};
    m.color = {0.8f, 0.6f, 0.3f}, m.specular_color = {0.9f, 1.0f, 0.7f};
    m.metallic = metallic, m.roughness = roughness, m.ior = ior, m.specular = specular;
    m.clearcoat_roughness = 0.1f, m.clearcoat_ior = 1.5f, m.sheen_roughness = 0.5f;
    m.iridescence_ior = 1.3f, m.iridescence_thickness = 400.0f;
    return m;
  };
  const auto as_block = [](const Principled& m) {
    ParamBlock b = block(MaterialKind::principled, {});
    to_block(m, b);
    return b;
  };
  // The last two as within denser glass
  plain_is_the_whole<Principled, PlainPrincipled>(
      {as_block(principled(0.0f, 0.5f, 1.5f, 1)), as_block(principled(1.0f, 0.2f, 1.5f, 1)),
       as_block(principled(0.4f, 0.0f, 1.3f, 0.5f)), as_block(principled(0.9f, 1.0f, 1.0f, 0)),
       as_block(principled(0.0f, 0.5f, 0.625f, 1)), as_block(principled(0.4f, 0.3f, 0.98f, 1))});
  for (float Principled::* layer :
       {&Principled::transmission, &Principled::clearcoat, &Principled::iridescence,
        &Principled::anisotropy, &Principled::diffuse_roughness}) {
    Principled m = principled(0.5f, 0.5f, 1.5f, 1);
    m.*layer = 0.1f;
    CHECK(!PlainPrincipled::fits(m));
  }
  Principled velvet = principled(0.5f, 0.5f, 1.5f, 1);
  velvet.sheen_color.y = 0.1f;
  CHECK(!PlainPrincipled::fits(velvet));
  const auto plastic = [](float ior, float roughness, float nonlinear, float compensation,
                          float distribution = 0) {
    return block(MaterialKind::plastic, {0.8f, 0.0f, 0.3f, 1, 0.9f, 0.7f, ior, roughness,
                                         distribution, nonlinear, compensation});
  };
  const std::vector<ParamBlock> smooths = {plastic(1.49f, 0, 0, 0), plastic(2.5f, 0.01f, 1, 1),
                                           plastic(1.0f, 0, 0, 1)};
  const std::vector<ParamBlock> roughs = {plastic(1.49f, 0.3f, 0, 0), plastic(2.5f, 0.0101f, 1, 1),
                                          plastic(1.0f, 1, 0, 1)};
  const std::vector<ParamBlock> beckmanns = {
      plastic(1.49f, 0.3f, 0, 0, 1), plastic(2.5f, 0.0101f, 1, 1, 1), plastic(1.0f, 1, 0, 1, 1)};
  plain_is_the_whole<Plastic, SmoothPlastic>(smooths);
  plain_is_the_whole<Plastic, RoughPlastic<Facets::ggx>>(roughs);
  plain_is_the_whole<Plastic, RoughPlastic<Facets::beckmann>>(beckmanns);
  // What is worked out of a scene's plastic once is what is worked out anew each time.
  plain_is_the_whole<Plastic, SmoothPlastic>(derived<SmoothPlastic>(smooths));
  plain_is_the_whole<Plastic, RoughPlastic<Facets::ggx>>(
      derived<RoughPlastic<Facets::ggx>>(roughs));
  plain_is_the_whole<Plastic, RoughPlastic<Facets::beckmann>>(
      derived<RoughPlastic<Facets::beckmann>>(beckmanns));
  // By hand: straight down an index of 1.5 reflects 0.04, and its inside throws back 1 - (1 -
  // 0.0917765) / 2.25 = 0.596345 of diffuse light.
  const BsdfValue down = value_of(SmoothPlastic::of(from_block<Plastic>(plastic(1.5f, 0, 0, 0))),
                                  {0, 0, 1}, {0, 0, 1});
  const float base = 0.96f * 0.96f / (kPi * 2.25f * (1.0f - 0.596345f));
  CHECK(std::abs(down.value.x - 0.8f * base) < 1e-5f && down.value.y == 0.0f);
  plain_is_the_whole<Dielectric, PlainDielectric>(
      {block(MaterialKind::dielectric, {1, 1, 1, 1.5f, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0}),
       block(MaterialKind::dielectric,
             {0.9f, 0.8f, 1, 0.6f, 0, 0.5f, 1, 1, 0.5f, 1, 1, 1, 1, 0.2f, 0.4f})});
}

// How often mirrors are followed changes neither what comes back nor what densities say, but how
// many samples do.
void what_is_pulled_to_mirrors_is_as_bright() {
  double mirrored = 0.0;  // share of the samples
  const auto mean_weight = [&](const auto& m, Vec3 wo) {
    double sum = 0.0;
    mirrored = 0.0;
    constexpr int kSide = 512;
    for (int i = 0; i < kSide; ++i) {
      for (int j = 0; j < 16; ++j) {
        const float u = (static_cast<float>(i) + 0.5f) / kSide;
        baseline::BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
        if (!sample(m, wo, {{u, (static_cast<float>(j) + 0.5f) / 16}, u}, s)) continue;
        sum += static_cast<double>(s.weight.y);
        mirrored += s.delta && s.wi.z * wo.z > 0.0f ? 1.0 / (kSide * 16) : 0.0;
        CHECK(s.delta || std::abs(value_of(m, wo, s.wi).pdf / s.pdf - 1.0f) < 1e-5f);
      }
    }
    return sum / (kSide * 16);
  };
  baseline::Plastic plastic = {{0.3f, 0.7f, 0.2f}, {0.9f, 0.8f, 1}, 1.6f, 0, 0, 1, 0, 0, 0};
  baseline::Dielectric glass = {{1, 1, 1}, 1.5f, 0, 0, 0, 0, {1, 0.9f, 1}, {1, 0.8f, 1}, 0, 0};
  for (float z : {1.0f, 0.7f, 0.3f, 0.05f, -0.9f, -0.5f}) {
    const Vec3 wo = {std::sqrt(1.0f - z * z), 0, z};
    const auto pulled_is_as_bright = [&](auto& m) {
      m.mirror_pull = 0.0f;
      const double mean = mean_weight(m, wo), share = mirrored;
      m.mirror_pull = 2.0f;
      CHECK(std::abs(mean_weight(m, wo) / mean - 1.0) < 3e-3);
      CHECK(std::abs(mirrored - 3.0 * share / (1.0 + 2.0 * share)) < 5e-3);
    };
    pulled_is_as_bright(plastic);
    pulled_is_as_bright(glass);
  }
}

// Of visible slopes of a Beckmann surface u is the share of those that are less.
void beckmann_slopes_follow_their_distribution() {
  for (int i = 1; i < 400; ++i) {
    const double angle = i < 300 ? i * 0.005235 : 1.5707963 - std::pow(10.0, -0.06 * (i - 300));
    const float cosine = static_cast<float>(std::cos(angle));
    const double c = static_cast<double>(cosine), s = std::sqrt(1.0 - c * c), k = 0.28209479177;
    const double all = std::erf(c / s), tail = std::exp(-c * c / (s * s));
    const double total = 0.5 * c * (1.0 + all) + s * k * tail;
    for (int j = 0; j < 300; ++j) {
      const double u = j < 200   ? j / 200.0
                       : j < 250 ? std::pow(10.0, -0.14 * (j - 199))
                                 : 1.0 - std::pow(10.0, -0.14 * (j - 249));
      const float at =
          baseline::visible_beckmann_slope(cosine, static_cast<float>(s), static_cast<float>(u));
      const double q = static_cast<double>(at);
      const double less = 0.5 * c * (std::erf(q) + all) + s * k * (tail - std::exp(-q * q));
      CHECK(std::abs(less / total - u) < 1e-6);
    }
  }
}

// All kinds of shapes and lights, instances of a group that shines, holes, and features.
void everything_at_once() {
  const Cloud cloud(300);
  const std::vector<double> corners = {0, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0, 1};
  const std::vector<u32> faces = {0, 1, 2, 0, 2, 3};
  const std::vector<float> normals = {0, 1, 0, 0.1f, 1, 0, 0, 1, 0.1f, 0, 2, 0};
  const std::vector<float> uvs = {0, 0, 1, 0, 1, 1, 0, 1};
  ShapeInput mesh;
  mesh.kind = ShapeKind::triangle;
  mesh.name = "mesh";
  mesh.count = 2;
  mesh.vertex_count = 4;
  mesh.faces = faces.data();
  mesh.normals = normals.data();
  mesh.uvs = uvs.data();
  mesh.arrays = {{"vertices", corners.data(), true, false, 3}};
  ShapeInput lamp = mesh;
  lamp.name = "lamp";
  lamp.material = 3;
  const std::vector<double> disk = {0.5, 0.6, 0.5}, u = {0.2, 0, 0}, v = {0, 0, 0.3};
  ShapeInput round;
  round.kind = ShapeKind::disk;
  round.name = "disk";
  round.count = 1;
  round.material = 3;
  round.arrays = {{"centers", disk.data(), true, false, 3},
                  {"axis_u", u.data(), true, false, 3},
                  {"axis_v", v.data(), true, false, 3}};
  const double matrices[] = {1,   0, 0, 0.1, 0, 0.5, 0,   0.8, 0, 0, 1,    0,
                             0.3, 0, 0, 0.5, 0, 0.3, 0.1, 0.9, 0, 0, -0.3, 0.5};
  ShapeInput copies;
  copies.kind = ShapeKind::instance;
  copies.name = "copies";
  copies.count = 2;
  copies.transforms = matrices;
  SceneInput input =
      input_of({cloud.group(), mesh, round, copies}, Cloud::materials(), {{lamp, cloud.group()}});
  input.materials[0].opacity = 0.7f;
  input.lights.push_back(light(LightKind::point, {1, 1, 1, 0.5f, 2, 0.5f}));
  const Scene scene(std::move(input));
  RenderView view = make_view(scene, 24, 16, SamplerKind::sobol);
  Film reference(0, 0, 24, 16, true);
  render_pass(kernels("baseline"), scene, view, reference, all_to(reference, 8),
              {1, 16, Schedule::dynamic_}, kNever);
  u64 bad = 0;
  for (const FilmPixel& p : reference.pixels) bad += p.bad;
  CHECK(bad == 0);
  for (const std::string& isa : instruction_sets()) {
    Film film(0, 0, 24, 16, true);
    render_pass(kernels(isa), scene, view, film, all_to(film, 8), {3, 5, Schedule::dynamic_},
                kNever);
    CHECK(same(reference, film));
    CHECK(std::memcmp(film.features.data(), reference.features.data(),
                      film.features.size() * sizeof(FeaturePixel)) == 0);
  }
  view.tree = false;
  Film film(0, 0, 24, 16);
  render_pass(kernels(), scene, view, film, all_to(film, 8), {2, 16, Schedule::dynamic_}, kNever);
  CHECK(same(reference, film));
}

// Of few spheres, and of many; so uneven that no grid divides large parts; all but one in one cell
// of the first grid, so that all threads divide them once more; and of several kinds.
void trees_do_not_depend_on_threads() {
  const std::vector<double> triangle = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  struct {
    size_t n;
    bool uneven, a_speck;
  } const cases[] = {
      {20000, false, false}, {100000, true, false}, {100000, false, true}, {530000, true, true}};
  for (const auto& [n, uneven, a_speck] : cases) {
    Cloud cloud(n);
    // Of few some shine; trees of many lights would take most of the time.
    if (n > 20000) std::fill(cloud.material.begin(), cloud.material.end(), 0u);
    for (size_t k = 0; uneven && k < 3 * n; ++k) cloud.centers[k] = std::pow(cloud.centers[k], 6.0);
    if (a_speck) {
      cloud.centers[3 * n] = cloud.centers[3 * n + 1] = cloud.centers[3 * n + 2] = 1000.0;
      cloud.radii[n] = 1.0;
    }
    const std::vector<u32> faces(3 * 5000, 0);
    ShapeInput mesh;
    mesh.kind = ShapeKind::triangle;
    mesh.name = "mesh";
    mesh.count = 5000;
    mesh.vertex_count = 3;
    mesh.faces = faces.data();
    mesh.arrays = {{"vertices", triangle.data(), true, false, 3}};
    std::vector<std::unique_ptr<Scene>> scenes;
    for (int threads : {1, 5}) {
      omp_set_num_threads(threads);
      scenes.push_back(
          std::make_unique<Scene>(input_of({cloud.group(), mesh}, Cloud::materials())));
    }
    omp_set_num_threads(omp_get_num_procs());
    const SceneView& a = scenes[0]->view();
    CHECK(a.sphere_blocks * 16 > n && a.triangle_blocks * 16 > mesh.count);
    for (const auto& scene : scenes) {
      const SceneView& b = scene->view();
      CHECK(scene->node_count() == scenes[0]->node_count() && a.root == b.root);
      CHECK(a.sphere_blocks == b.sphere_blocks && a.triangle_blocks == b.triangle_blocks);
      CHECK(std::memcmp(a.nodes, b.nodes, scene->node_count() * sizeof(Node)) == 0);
      CHECK(std::memcmp(a.spheres, b.spheres, a.sphere_blocks * sizeof(SphereBlock)) == 0);
      CHECK(std::memcmp(a.triangles, b.triangles, a.triangle_blocks * sizeof(TriangleBlock)) == 0);
    }
  }
}

#if defined(__linux__)
// The processors that each thread of OpenMP may run on.
std::vector<std::vector<bool>> processors_of_threads(int threads) {
  std::vector<std::vector<bool>> found(static_cast<size_t>(threads));
#pragma omp parallel num_threads(threads)
  {
    cpu_set_t may;
    CPU_ZERO(&may);
    sched_getaffinity(0, sizeof may, &may);  // none of more than a thousand
    for (size_t k = 0; k < CPU_SETSIZE; ++k) {
      found[static_cast<size_t>(omp_get_thread_num())].push_back(CPU_ISSET(k, &may));
    }
  }
  return found;
}

void threads_wake_apart_and_are_free_again() {
  const auto before = processors_of_threads(2);
  if (std::count(before[0].begin(), before[0].end(), true) < 2 ||
      omp_get_proc_bind() != omp_proc_bind_false) {
    return;
  }
  for (int time = 0; time < 3; ++time) {
#if !defined(__clang__)  // whose OpenMP, of LLVM 14, cannot go on after that
    if (time == 2) {
      release_threads();                                           // others take their place
      std::this_thread::sleep_for(std::chrono::milliseconds(50));  // they are not gone at once
    }
#endif
    {
      const WakeApart apart(2);
      const auto during = processors_of_threads(2);
      CHECK(during[0] == before[0]);
      size_t left_out = 0;
      for (size_t k = 0; k < CPU_SETSIZE; ++k) left_out += before[1][k] && !during[1][k];
      CHECK(left_out == 1);
    }
    CHECK(processors_of_threads(2) == before);
    for (int threads : {1, 1000}) {
      const WakeApart apart(threads);
      CHECK(processors_of_threads(2) == before);
    }
  }
}
#endif

// Centres that coincide, and sizes over fourteen powers of ten: the tree's depth stays bounded.
void hard_cases_build() {
  std::vector<double> centers, radii;
  for (int i = 0; i < 5000; ++i) {
    const double x = i < 2000 ? 0.0 : std::ldexp(1.0, -(i % 45));
    centers.insert(centers.end(), {x, 0.0, 0.0});
    radii.push_back(std::ldexp(1.0, -(i % 48)));
  }
  ShapeInput g;
  g.name = "hard";
  g.count = radii.size();
  g.arrays = {{"centers", centers.data(), true, false, 3}, {"radii", radii.data(), true, false, 1}};
  const Scene scene(input_of({g}, Cloud::materials()));
  const Ray ray = {{0.9f, 0.9f, 0.9f}, {-0.57735026f, -0.57735026f, -0.57735026f}, kNoSlot, false};
  const float limit = kInfinity;
  Hit tree, brute;
  kernels().intersect(scene.view(), &ray, &limit, 1, true, &tree);
  kernels().intersect(scene.view(), &ray, &limit, 1, false, &brute);
  CHECK(tree.slot.leaf != kNone && tree.t == brute.t && tree.slot.leaf == brute.slot.leaf);
}

// Triangles without an area, aimed at: neither nearest hits nor shadow rays meet them.
void lines_stop_nothing() {
  const std::vector<float> vertices = {0.125f, 0.25f, 0.5f, 0.375f, 0.75f, 0.75f,
                                       0.625f, 1.25f, 1.0f, 0.375f, 0.75f, 0.75f};
  const std::vector<u32> faces = {0, 1, 2, 0, 1, 3, 2, 2, 2};
  ShapeInput lines;
  lines.kind = ShapeKind::triangle;
  lines.name = "lines";
  lines.count = faces.size() / 3;
  lines.vertex_count = vertices.size() / 3;
  lines.faces = faces.data();
  lines.arrays = {{"vertices", vertices.data(), false, false, 3}};
  const Scene scene(input_of({lines}, Cloud::materials()));
  std::mt19937 engine(5);
  std::uniform_real_distribution<float> uniform(0.0f, 1.0f);
  for (int i = 0; i < 2000; ++i) {
    const float at = uniform(engine);
    const Vec3 target = {0.125f + 0.5f * at, 0.25f + at, 0.5f + 0.5f * at};
    const Vec3 from = {uniform(engine), uniform(engine), uniform(engine)};
    const Vec3 way = {target.x - from.x, target.y - from.y, target.z - from.z};
    const float unit = static_cast<float>(1.0 / scene.view().unit);
    const Ray ray = {{from.x * unit, from.y * unit, from.z * unit}, way, kNoSlot, false};
    const float limit = kInfinity;
    for (const bool tree : {true, false}) {
      Hit hit;
      u8 blocked = 1;
      kernels().intersect(scene.view(), &ray, &limit, 1, tree, &hit);
      kernels().occluded(scene.view(), &ray, &limit, 1, tree, &blocked);
      CHECK(hit.slot.leaf == kNone && blocked == 0);
    }
  }
}

void a_pass_can_be_stopped() {
  const Cloud cloud(2000);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const RenderView view = make_view(scene, 200, 200, SamplerKind::sobol);
  Film film(0, 0, 200, 200);
  int calls = 0;
  const PassResult r =
      render_pass(kernels(), scene, view, film, all_to(film, 1000), {3, 4, Schedule::dynamic_},
                  [&](u64, u64) { return ++calls >= 2; });
  CHECK(!r.complete && calls == 2 && r.samples < 200ull * 200 * 1000);
  u64 counted = 0;
  for (const FilmPixel& p : film.pixels) counted += p.count;
  CHECK(counted == r.samples);
}

// A pass that is stopped wherever leaves pixels whose samples are the first so many of theirs; one
// that goes on makes the same picture, errors included.
void passes_go_on_where_they_stopped() {
  const Cloud cloud(300);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const RenderView view = make_view(scene, 40, 24, SamplerKind::sobol);
  Film whole(0, 0, 40, 24, true, true), stopped(0, 0, 40, 24, true, true);
  render_pass(kernels(), scene, view, whole, all_to(whole, 400), {2, 16, Schedule::dynamic_},
              kNever);
  u32 stops = 0;
  for (bool complete = false; !complete; ++stops) {
    const u32 tile = 3 + 5 * (stops % 4);  // runs end elsewhere
    complete = render_pass(kernels(), scene, view, stopped, all_to(stopped, 400),
                           {3, tile, Schedule::dynamic_}, [](u64, u64) { return true; })
                   .complete;
  }
  CHECK(stops > 2);
  CHECK(same(whole, stopped));
  CHECK(std::memcmp(whole.features.data(), stopped.features.data(),
                    whole.features.size() * sizeof(FeaturePixel)) == 0);
  CHECK(std::memcmp(whole.prefixes.data(), stopped.prefixes.data(),
                    whole.prefixes.size() * sizeof(Prefix)) == 0);
  std::vector<double> a(all_to(whole, 0).samples.size()), b(a.size());
  whole.errors(a.data());
  stopped.errors(b.data());
  CHECK(a == b);
}

// Parts that go on where the whole film is, each of some of its blocks, make the same picture,
// features and errors included.
void parts_made_elsewhere_add_up() {
  const Cloud cloud(300);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const RenderView view = make_view(scene, 60, 40, SamplerKind::sobol);
  const u32 width = 45, height = 27;  // 6 x 4 blocks; at the edges some lack pixels
  Film whole(3, 2, width, height, true, true), made(3, 2, width, height, true, true);
  Targets targets = all_to(whole, 0);
  for (size_t i = 0; i < targets.samples.size(); ++i) targets.samples[i] = 20 + 7 * (i % 9);
  render_pass(kernels(), scene, view, whole, targets, {2, 16, Schedule::dynamic_}, kNever);
  // Some pixels of a cell have samples already, others have none
  std::vector<u32> begin(made.pixels.size(), 0);
  std::fill_n(begin.begin(), begin.size() / 3, 9);
  render_pass(kernels(), scene, view, made, {begin, true}, {2, 16, Schedule::dynamic_}, kNever);
  const u32 across = made.cells_across();
  for (u32 parts = 0; !same(whole, made); ++parts) {
    const u32 bx = 3 * (parts % 2), by = 2 * (parts / 2 % 2);
    const u32 x0 = 8 * bx, y0 = 8 * by, w = std::min(24u, width - x0),
              h = std::min(16u, height - y0);
    Film part(3 + x0, 2 + y0, w, h, true, parts < 4);
    std::vector<u32> begun;
    Targets to = all_to(part, 0);
    for (u32 line = 0; line < part.cells_down(); ++line) {
      for (u32 column = 0; column < part.cells_across(); ++column) {
        to.samples[line * part.cells_across() + column] =
            targets.samples[(2 * by + line) * across + bx + column];
      }
    }
    for (u32 y = 0; y < h; ++y) {
      for (u32 x = 0; x < w; ++x) {
        const size_t at = (y0 + y) * width + x0 + x;
        const u32 from = made.pixels[at].count;
        begun.push_back(from);
        part.features[y * w + x] = made.features[at];
        u32& target = to.samples[part.cell_row(y) * part.cells_across() + x / kBlock];
        target = std::min(target, from == 0 ? 5 : std::bit_ceil(from + 1));
      }
    }
    part.begin(begun);
    render_pass(kernels(), scene, view, part, to, {3, 5, Schedule::dynamic_}, kNever);
    made.add(part, begun);
    const auto said = [&](const Film& other, const std::vector<u32>& counts) {
      return message_of([&] { made.add(other, counts); });
    };
    if (begun[0] != made.pixels[y0 * width + x0].count) {  // it came twice
      CHECK(said(part, begun).find("does not begin") != std::string::npos);
    }
    CHECK(said(part, {1, 2}).find("as many numbers") != std::string::npos);
    const Film beyond(40, 2, 16, 8, true), before(2, 2, 8, 8, true), plain(3, 2, 1, 1);
    CHECK(said(beyond, {}).find("within") != std::string::npos);
    CHECK(said(before, {}).find("within") != std::string::npos);
    CHECK(said(plain, {0}).find("features") != std::string::npos);
    CHECK(parts < 200);
    if (parts == 200) return;
  }
  CHECK(std::memcmp(whole.features.data(), made.features.data(),
                    whole.features.size() * sizeof(FeaturePixel)) == 0);
  CHECK(std::memcmp(whole.prefixes.data(), made.prefixes.data(),
                    whole.prefixes.size() * sizeof(Prefix)) == 0);
  Film one(0, 0, 1, 1, false, true), far(0, 0, 1, 1);  // too far to tell errors
  render_pass(kernels(), scene, view, one, all_to(one, 1), {1, 16, Schedule::dynamic_}, kNever);
  far.begin(std::vector<u32>{1});
  render_pass(kernels(), scene, view, far, all_to(far, 3), {1, 16, Schedule::dynamic_}, kNever);
  CHECK(message_of([&] { one.add(far, std::vector<u32>{1}); }).find("errors") != std::string::npos);
}

void sums_are_exact_in_any_order() {
  const float values[] = {1e-12f, 3.25f, 1e9f, 0.1f, 7e-5f, 123456.78f, 0.0f, 1e30f, -1.0f};
  FilmPixel forth{}, back{};
  for (int i = 0; i < 9; ++i) {
    baseline::add(forth, {values[i], values[i], values[i]});
    baseline::add(back, {values[8 - i], values[8 - i], values[8 - i]});
    baseline::carry(back);
  }
  baseline::carry(forth);
  CHECK(std::memcmp(&forth, &back, sizeof forth) == 0);
  baseline::add(forth, {std::nanf(""), 0, 0});
  CHECK(forth.bad == 1 && forth.count == 10);
}

void mistakes_are_named() {
  Cloud cloud(40);
  const auto make = [&] { Scene(input_of({cloud.group()}, Cloud::materials())); };
  CHECK(message_of(make).empty());
  cloud.radii[17] = -1.0;
  CHECK(message_of(make).find("shape 'cloud': radii[17] is -1") == 0);
  cloud.radii[17] = 1.0;
  cloud.centers[3 * 5 + 1] = NAN;
  CHECK(message_of(make).find("centers[5] is not finite: y") != std::string::npos);
  cloud.centers[3 * 5 + 1] = 0.0;
  cloud.material[9] = 14;
  CHECK(message_of(make).find("material[9] is 14; the scene has materials 0 to 13") !=
        std::string::npos);
  cloud.material[9] = 0;
  cloud.radii[3] = 1e-20;
  CHECK(message_of(make).find("radii[3] is 1e-20, but the scene reaches out to 2000") !=
        std::string::npos);
  cloud.radii[3] = 1.0;
  std::vector<float> colors(3 * cloud.radii.size(), 0.5f);
  ShapeInput group = cloud.group();
  group.colors = colors.data();
  colors[3 * 14 + 1] = 255.0f;
  CHECK(message_of([&] {
          Scene(input_of({group}, Cloud::materials()));
        }).find("colors[14] is 255 in g; the colour of diffuse must lie in [0, 1]") !=
        std::string::npos);
  CHECK(message_of([] { kernels("mmx"); }).find("baseline") != std::string::npos);
  CHECK(message_of([] { make_filter("boxy", 0.0); }).find("tent") != std::string::npos);
  CameraInput camera{};
  camera.eye[0] = camera.target[0] = 1.0;
  camera.up[1] = 1.0;
  camera.vfov = 40.0;
  camera.projection = "perspective";
  CHECK(message_of([&] { make_camera(camera, 4, 4, 1.0, Box{}); }).find("same point") !=
        std::string::npos);
}

// Rows decide for each other how many samples they get, so none shares with the other ones.
void groups_are_of_even_rows_or_of_odd_ones() {
  for (u64 key = 0; key < 200; ++key) {
    std::vector<u32> met(kRegionPixels);
    for (u32 parity : {0u, 1u}) {
      for (u32 i = 0; i < kRegionPixels / 2; ++i) {
        const u32 pixel = baseline::pixel_in_region(baseline::mix(key), parity, i);
        CHECK(pixel < kRegionPixels && pixel / kRegion % 2 == parity && met[pixel]++ == 0);
      }
    }
  }
}

void probes_run() {
  const Cloud cloud(100);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const Kernels& k = kernels();
  for (const ParamBlock& m : Cloud::materials()) {
    std::vector<BsdfProbe> probes(64);
    k.bsdf_sample(m, {0.6f, 0.0f, 0.8f}, SamplerKind::independent, 1, probes.size(), probes.data());
    for (const BsdfProbe& p : probes) {
      if (baseline::black(p.weight) || p.delta) continue;  // the first did not scatter
      Vec3 value;
      float pdf;
      k.bsdf_eval(m, {0.6f, 0.0f, 0.8f}, &p.wi, 1, &value, &pdf);
      CHECK(baseline::finite(value));
      CHECK(std::abs(pdf - p.pdf) <= 1e-5f * p.pdf);
    }
  }
  std::vector<LightProbe> lights(64);
  k.light_sample(scene.view(), {0.0f, 0.9f, 0.0f}, 1, lights.size(), lights.data());
  for (const LightProbe& l : lights) CHECK(l.pdf > 0.0f);
  const Scene empty(input_of({}, {}));
  const RenderView view = make_view(empty, 3, 3, SamplerKind::sobol);
  CHECK(k.radiance(empty.view(), view, 1, 1, 0).x == 1.0f);
}

}  // namespace

int main() {
  pictures_do_not_depend_on_how_they_are_made(false);
  pictures_do_not_depend_on_how_they_are_made(true);
  groups_are_of_even_rows_or_of_odd_ones();
  batches_are_their_samples();
  trees_cost_what_lines_meet();
  every_walk_is_counted();
  samples_that_are_not_finite_are_counted_and_left_out();
  rays_meet_the_same_through_the_tree_and_without();
  rays_together_meet_what_each_meets();
  bundles_meet_what_their_rays_meet();
  partitions_keep_their_order();
  several_threads_divide_as_one_does();
  lobes_share_even_numbers();
  plain_materials_are_the_whole();
  what_is_pulled_to_mirrors_is_as_bright();
  beckmann_slopes_follow_their_distribution();
  everything_at_once();
  trees_do_not_depend_on_threads();
  hard_cases_build();
  lines_stop_nothing();
  a_pass_can_be_stopped();
  passes_go_on_where_they_stopped();
  parts_made_elsewhere_add_up();
  sums_are_exact_in_any_order();
  mistakes_are_named();
  probes_run();
#if defined(__linux__)
  threads_wake_apart_and_are_free_again();
#endif
  release_threads();
  std::printf("core tests: %d failed\n", failures);
  return failures == 0 ? 0 : 1;
}
