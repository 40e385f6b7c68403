// Tests of rays: one by one, sixteen that begin together, and bundles, against each other and
// against rays that ask every primitive.
#include <omp.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "../../core/packet.h"
#include "../../host/rays.h"
#include "check.h"
#include "cloud.h"

namespace {

using namespace parhelion;

// A walk visits the nearest child of the node it was at, as far as its limit goes, and then goes
// back; where any hit will do, the last.
template <bool kAny>
void stacks_give_what_is_next() {
  using namespace baseline;
  std::mt19937 random(1);
  u64 given = 0, beyond = 0;
  for (u32 walk = 0; walk < 200; ++walk) {
    struct Open {
      float near;
      u32 lane;
      Child child;
    };
    std::vector<std::vector<Open>> levels;
    std::vector<Node> nodes(400);
    typename Stack<kAny>::Room room;
    Stack<kAny> stack(room);
    float limit = kInfinity;
    // Sixteen floats apart, which is as far as they are told apart; some are the same.
    const auto distance = [&] {
      const u32 step = static_cast<u32>(random() % 64);
      return step == 0 ? 0u : 0x40000000u + 16 * step;
    };
    const auto expected = [&](Child& child) {
      for (; !levels.empty(); levels.pop_back()) {
        std::vector<Open>& level = levels.back();
        const auto first = std::min_element(level.begin(), level.end(), [](Open a, Open b) {
          return kAny ? a.lane > b.lane : std::pair(a.near, a.lane) < std::pair(b.near, b.lane);
        });
        if (first == level.end() || !(kAny || first->near <= limit)) {
          beyond += first != level.end() ? 1 : 0;
          continue;
        }
        child = first->child;
        level.erase(first);
        return true;
      }
      return false;
    };
    for (u32 i = 0; i < nodes.size(); ++i) {
      Child next = kNone, known = kNone;
      bool there = false;
      if (levels.size() < kMaxTreeDepth && random() % 3 != 0) {
        alignas(64) float near[16], met[16];
        std::vector<Open> level;
        const u32 of_sixteen = random() % 17;
        for (u32 k = 0; k < 16; ++k) {
          nodes[i].child[k] = 16 * i + k;
          const u32 own = distance();
          near[k] = std::bit_cast<float>(own | static_cast<u32>(random() % 16));
          met[k] = random() % 16 < of_sixteen ? 1.0f : 0.0f;
          if (met[k] > 0.0f) level.push_back({std::bit_cast<float>(own), k, nodes[i].child[k]});
        }
        const bool any = !level.empty();
        const LaneMask hits = all(0.0f) < load(met);
        if (levels.empty() && i % 2 == 0) {
          typename Stack<kAny>::Start start;
          Stack<kAny>::prepare(nodes[i], load(near), hits, start);
          there = stack.begin(start, next);
          CHECK(there == any);
        } else {
          there = stack.push(nodes[i], load(near), hits, next);
        }
        levels.push_back(level);
        if (there) {  // the nearest, however far away
          const float own = std::exchange(limit, kInfinity);
          CHECK(expected(known) && next == known);
          limit = own;
          ++given;
          continue;
        }
      } else if (random() % 8 == 0) {
        limit = std::min(limit, std::bit_cast<float>(distance()));
      }
      there = stack.pop(next, limit);
      CHECK(there == expected(known) && next == known);
      given += there ? 1 : 0;
      if (!there) limit = kInfinity;
    }
  }
  CHECK(given > 20'000 && (kAny ? beyond == 0 : beyond > 1'000));
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
      kernels("baseline").radiance(scene.view(), view, i % 16, i / 16, 0, stats);
      const u64 walked = stats.walks - (kTimedWalks - 1);
      CHECK(walked == stats.rays || (walked == 0 && stats.rays == 1));  // it passes the scene by
      timed += stats.timed_ticks;
    }
    CHECK(timed > 0 || compiler::ticks() == 0);
  }
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
    for (const std::string& isa : instruction_sets()) {
      const Answers tree = ask(scene, rays, true, isa), brute = ask(scene, rays, false, isa);
      for (size_t i = 0; i < rays.size(); ++i) {
        const Hit &a = tree.hits[i], &b = brute.hits[i];
        const bool hit = a.slot.leaf != kNone;
        CHECK(a.t == b.t && a.slot.leaf == b.slot.leaf && a.slot.lane == b.slot.lane);
        CHECK(hit == tree.blocked[i] && hit == brute.blocked[i]);
      }
    }
  }
}

// As those of a camera do: some lanes of sixteen, from one point or many, at angles from none to
// such that signs differ, along axes too. And those that begin together and go their own ways.
void rays_together_meet_what_each_meets() {
  using namespace baseline;
  int behind = 0, onward = 0, stopped = 0;
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
      // Those that are no rays meet nothing.
      if (i % 28 == 3) origin.set(lowest_bit(lanes), Vec3{NAN, 0, 0});
      if (i % 28 == 8) direction.set(lowest_bit(lanes), Vec3{0, 1, NAN});
      float t[kBatch], t_apart[kBatch];
      SlotRows<kBatch> slot, slot_apart;
      intersect_close(scene.view(), origin, direction, lanes, t, slot);
      Bundle bundle;
      const bool along_axis = i % 28 == 0;  // all of them, from one point
      CHECK(!along_axis || bundle_of(origin, direction, lanes, bundle));
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
      // From where these began or from what they met, up to limits of which some are 0.
      Packet packet;
      packet.inward = i * 0x9e3779b9u >> 8;
      float far[kBatch];
      for (u32 k = 0; k < kBatch; ++k) {
        const bool is = (lanes >> k & 1u) != 0 && slot.leaf[k] != kNone;
        const float way = i % 2 && is ? t[k] : 0.0f;
        packet.origin.set(k, origin.at(k) + direction.at(k) * way);
        packet.direction.set(k, direction.at(k));
        packet.self.set(k, is ? slot.at(k) : kNoSlot);
        far[k] = k % 5 == 4 ? 0.0f : k % 5 == 3 ? kInfinity : 0.3f * static_cast<float>(k % 5 + 1);
      }
      if (walk_close<false>(scene.view(), lanes, far, packet)) {
        for_each_bit(lanes, [&](u32 k) {
          Hit alone;
          intersect(scene.view(), packet.ray(k), far[k], true, alone);
          CHECK(packet.best.t[k] == alone.t && packet.best.slot.leaf[k] == alone.slot.leaf &&
                packet.best.slot.lane[k] == alone.slot.lane &&
                packet.best.slot.instance[k] == alone.slot.instance);
          onward += alone.slot.leaf != kNone ? 1 : 0;
        });
        CHECK(walk_close<true>(scene.view(), lanes, far, packet));
        for_each_bit(lanes, [&](u32 k) {
          const bool any = occluded(scene.view(), packet.ray(k), far[k], kNoSlot, true);
          CHECK((packet.met >> k & 1u) == (any ? 1u : 0u));
          stopped += any ? 1 : 0;
        });
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
  CHECK(behind > 400 && onward > 400 && stopped == onward);
}

// Sixteen rays close to each other, as of a camera with a lens or without.
struct Rays {
  baseline::Rows<Vec3, kBatch> origin, direction;

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
struct BundleMet {
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
        u32 met = 0;
        intersect(block, ray, limits[k], kNone, [&](u32 j, float distance) {
          met |= 1u << j, t[j] = distance;
          return limits[k];
        });
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
  BundleMet spheres, triangles;
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
    for (const bool tree : {true, false}) {
      const Answers answers = ask(scene, {ray}, tree);
      CHECK(answers.hits[0].slot.leaf == kNone && !answers.blocked[0]);
    }
  }
}

// By all threads and without the tree; those that set off from what others have met, too.
void rays_of_users_meet_the_same_by_all_threads() {
  const Cloud cloud(300);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const size_t n = 5000;  // more than one thread takes alone
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::vector<std::array<double, 3>> origins(n), directions(n);
  for (auto* rows : {&origins, &directions}) {
    for (auto& row : *rows) row = {uniform(engine), uniform(engine), uniform(engine)};
  }
  const double limit = 3.0;
  const Numbers limits = {"limits", &limit, true, true, 1};
  const auto rows = [](const std::vector<std::array<double, 3>>& of) {
    return Numbers{"rows", of.data(), true, false, 3};
  };
  struct Found {
    std::vector<double> distance;
    std::vector<std::int32_t> shape, instances;
    std::vector<std::int64_t> primitive, copy;
    std::vector<HitRay> looked;
    std::vector<Met> met;
    std::vector<u8> blocked;

    Found(const Scene& of, const UserRays& rays, bool tree)
        : distance(rays.n),
          shape(rays.n),
          instances(rays.n),
          primitive(rays.n),
          copy(rays.n),
          looked(rays.n),
          met(rays.n),
          blocked(rays.n) {
      const Stop never = [] { return false; };
      CHECK(intersect(of, kernels(), rays, tree,
                      {distance.data(), shape.data(), primitive.data(), instances.data(),
                       copy.data(), looked.data()},
                      never));
      CHECK(find_points(of, kernels(), looked.data(), rays.n, met.data(), never));
      CHECK(occluded(of, kernels(), rays, tree, blocked.data(), never));
      for (size_t i = 0; i < rays.n; ++i) {
        const HitRay& ray = looked[i];
        CHECK(met[i].slot.leaf == ray.hit.slot.leaf);
        if (ray.hit.slot.leaf == kNone) {
          CHECK(std::isnan(met[i].point.x) && std::isnan(met[i].normal.x));
          continue;
        }
        const Ray own = {ray.origin, ray.direction, kNoSlot, false};
        const baseline::Surface s = baseline::surface_at(of.view(), own, ray.hit);
        CHECK(std::memcmp(&met[i].point, &s.point, sizeof s.point) == 0);
        CHECK(std::memcmp(&met[i].normal, &s.normal, sizeof s.normal) == 0);
        CHECK(met[i].error == s.error && (met[i].inside_out != 0) == s.shape->inside_out);
      }
    }
  };
  UserRays rays{n, rows(origins), nullptr, rows(directions), limits};
  omp_set_num_threads(3);
  const Found first(scene, rays, true), brute(scene, rays, false);
  std::vector<Met> from;
  for (size_t i = 0; i < n; ++i) {
    const bool hit = first.shape[i] == 0;
    CHECK(hit == (first.blocked[i] != 0) && hit == (first.primitive[i] >= 0));
    CHECK(hit == (first.distance[i] <= limit) && first.copy[i] == -1);
    CHECK(first.distance[i] == brute.distance[i] && first.primitive[i] == brute.primitive[i]);
    CHECK(first.blocked[i] == brute.blocked[i]);
    if (hit) from.push_back(first.met[i]);
  }
  CHECK(from.size() > n / 4 && from.size() < n);
  rays = {from.size(), {}, from.data(), rows(directions), limits};
  const Found second(scene, rays, true), slowly(scene, rays, false);
  CHECK(second.distance == slowly.distance && second.primitive == slowly.primitive);
  from[5].slot = kNoSlot;
  CHECK(message_of([&] { Found(scene, rays, true); }).find("origins[5] has met nothing") == 0);
  omp_set_num_threads(omp_get_num_procs());
  rays = {n, rows(origins), nullptr, rows(directions), limits};
  directions[7] = {0.0, 0.0, 0.0};
  origins[6][1] = NAN;
  CHECK(message_of([&] { Found(scene, rays, true); }).find("origins[6] is (") == 0);
}

}  // namespace

int main() {
  stacks_give_what_is_next<false>();
  stacks_give_what_is_next<true>();
  every_walk_is_counted();
  rays_meet_the_same_through_the_tree_and_without();
  rays_together_meet_what_each_meets();
  bundles_meet_what_their_rays_meet();
  lines_stop_nothing();
  rays_of_users_meet_the_same_by_all_threads();
  return finished("ray");
}
