// Tests of trees: what they cost, how they are divided, by how many threads, and of hard cases.
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <memory>
#include <random>
#include <vector>

#include "../../core/traverse.h"
#include "../../host/bins.h"
#include "../../host/cell_sort.h"
#include "../../host/order.h"
#include "../../host/partition.h"
#include "../../host/reinsert.h"
#include "../../host/shared_forks.h"
#include "../../host/tasks.h"
#include "../../host/tree_cost.h"
#include "check.h"
#include "cloud.h"

namespace {

using namespace parhelion;

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
      return bits(test_boxes(node, slabs, kInfinity, near));
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

bool same(const Extent& a, const Extent& b) {
  const Aabb one = a.box(), other = b.box();
  return std::memcmp(&one, &other, sizeof one) == 0;
}

// Primitives in cubes of ever smaller sides, so that most are in few cells of a grid.
std::vector<Ref> uneven_boxes(size_t n) {
  std::vector<Ref> refs(n);
  for (u32 i = 0; i < n; ++i) {
    for (u32 k = 0; k < 3; ++k) {
      const float at = static_cast<float>(baseline::mix(3 * i + k) >> 40) * 0x1p-24f;
      refs[i].low[k] = at * at * at, refs[i].high[k] = refs[i].low[k] + 1e-3f * at;
    }
    refs[i].id = i;
  }
  return refs;
}

// By all threads, and by tasks, as by one: the same bins, and parts in the order of their
// primitives.
void several_threads_sort_as_one_does() {
  omp_set_num_threads(3);
  for (const size_t n : {size_t{5000}, size_t{100003}, size_t{600000}}) {
    std::vector<Ref> refs = uneven_boxes(n), sorted(n);
    std::sort(refs.begin(), refs.end(),
              [](const Ref& a, const Ref& b) { return a.low[0] < b.low[0]; });
    const tree::Part whole = tree::measure(refs.data(), n);
    const tree::Grid grid(whole.centers, n);
    const auto where_they_are = [&](size_t first, size_t, Ref*) { return &refs[first]; };
    std::vector<tree::Bin> bins(grid.count());
    for (const Ref& r : refs) bins[grid.cell_of(r)].add(r);
    constexpr size_t kParts = 100;
    std::vector<std::uint16_t> part_of(grid.count());
    for (size_t c = 0; c < part_of.size(); ++c) part_of[c] = baseline::mix(c) % kParts;
    std::vector<Ref> expected = refs;
    std::stable_sort(expected.begin(), expected.end(), [&](const Ref& a, const Ref& b) {
      return part_of[grid.cell_of(a)] < part_of[grid.cell_of(b)];
    });
    const auto check = [&]<class Share>(const tree::CellSort<Share>& sort) {
      bool alike = true;
      for (size_t c = 0; c < bins.size(); ++c) {
        alike =
            alike && bins[c].count == sort.bins()[c].count && same(bins[c].box, sort.bins()[c].box);
      }
      CHECK(alike);
      std::fill(sorted.begin(), sorted.end(), Ref{});
      const std::vector<size_t> begin = sort.sort_to(refs.data(), sorted.data(), kParts, part_of);
      CHECK(std::memcmp(sorted.data(), expected.data(), n * sizeof(Ref)) == 0);
      for (size_t p = 0; p < kParts; ++p) {
        CHECK(begin[p] == n || part_of[grid.cell_of(sorted[begin[p]])] >= p);
        CHECK(begin[p] == 0 || part_of[grid.cell_of(sorted[begin[p] - 1])] < p);
      }
    };
    check(tree::CellSort<ByOneThread>(grid, n, where_they_are));
    check(tree::CellSort<ByAllThreads>(grid, n, where_they_are));
    tree::Part measured;
#pragma omp parallel
#pragma omp single
    {
      check(tree::CellSort<ByTasks>(grid, n, where_they_are));
      measured = tree::measure_by<ByTasks>(n, [&](size_t i) -> const Ref& { return refs[i]; });
    }
    CHECK(measured.size == n);
    CHECK(same(measured.box, whole.box) && same(measured.centers, whole.centers));
  }
  omp_set_num_threads(omp_get_num_procs());
}

// Of a fork and all below it: the surface of those with halves; each has the box and the number of
// primitives of its halves, and knows that it is above them.
double surface_below(const tree::Fork& f, std::vector<bool>& seen) {
  if (!f.left) {
    for (size_t i = 0; i < f.size; ++i) {
      CHECK(!seen[f.refs[i].id]);
      seen[f.refs[i].id] = true;
    }
    return 0.0;
  }
  Extent box = f.left->box;
  box.grow(f.right->box);
  CHECK(same(f.box, box));
  CHECK(f.size == f.left->size + f.right->size);
  CHECK(f.left->parent == &f && f.right->parent == &f);
  return static_cast<double>(f.box.half_area()) + surface_below(*f.left, seen) +
         surface_below(*f.right, seen);
}

// Of a fork and all below it: as up to so many children of a node each costs the least of all ways
// to give these to its halves, and to be one child itself.
void costs_are_the_least(const tree::Fork& f) {
  if (!f.left) return;
  const float* const a = f.left->cost;
  const float* const b = f.right->cost;
  const auto shared = [&](int children) {
    float least = kInfinity;
    for (int k = 1; k < children; ++k) least = std::min(least, a[k - 1] + b[children - k - 1]);
    return least;
  };
  const float own = f.box.half_area();
  const float alone =
      f.size > tree::kLeafSize ? shared(16) + own + f.upkeep.node : own + f.upkeep.leaf;
  CHECK(f.cost[0] == alone);
  for (int children = 2; children < 16; ++children) {
    CHECK(f.cost[children - 1] == std::min(alone, shared(children)));
  }
  costs_are_the_least(*f.left);
  costs_are_the_least(*f.right);
}

// Two forks, and all below them.
bool alike(const tree::Fork& a, const tree::Fork& b) {
  if (a.size != b.size || !same(a.box, b.box)) return false;
  if (!a.left || !b.left) return a.left == b.left;
  return alike(*a.left, *b.left) && alike(*a.right, *b.right);
}

int deepest(const tree::Fork& f) {
  return f.left ? 1 + std::max(deepest(*f.left), deepest(*f.right)) : 0;
}

// Of most in few cells of a grid; of all in two places, between which there is one plane, and in
// one; of small ones on both sides of some so large that no plane costs less than infinity; of so
// many powers of two that there would be more forks above each other than is allowed. The same by
// one thread and by three, with each primitive in one place.
void shared_forks_hold_all() {
  constexpr u32 kCount = 60000;
  enum { uneven, two_places, one_place, some_huge, powers, kCases };
  for (int which = 0; which < kCases; ++which) {
    std::vector<Ref> refs[2], spare(kCount);
    std::unique_ptr<tree::SharedForks> forks[2];
    const tree::Fork* top[2];
    for (const int run : {0, 1}) {
      refs[run] = uneven_boxes(kCount);
      for (u32 i = 0; i < kCount; ++i) {
        Ref& r = refs[run][i];
        for (u32 k = 0; k < 3; ++k) {
          if (which == two_places || which == one_place) {
            r.low[k] = r.high[k] = which == two_places ? static_cast<float>(i % 2) : 0.0f;
          } else if (which == some_huge && i % 3 == 1) {
            r.low[k] = k == 0 ? 10.0f : -1e30f, r.high[k] = k == 0 ? 11.0f : 1e30f;
          } else if (which == some_huge && i % 3 == 2 && k == 0) {
            r.low[k] += 20.0f, r.high[k] += 20.0f;
          } else if (which == powers) {
            r.low[k] = r.high[k] = std::ldexp(r.high[k], -static_cast<int>(i % 120));
          }
        }
      }
      const tree::Part whole = tree::measure(refs[run].data(), kCount);
      forks[run] = std::make_unique<tree::SharedForks>();
#pragma omp parallel num_threads(run == 0 ? 1 : 3)
#pragma omp single
      forks[run]->begin(whole, spare.data());
      const tree::Fork& f = forks[run]->finish();
      top[run] = &f;
      std::vector<bool> seen(kCount, false);
      surface_below(f, seen);
      CHECK(std::find(seen.begin(), seen.end(), false) == seen.end());
      CHECK(f.size == kCount && !f.parent);
      // What is halved by how many there are has seventeen more forks above each other, and those
      // that move bring a dozen or so.
      CHECK(deepest(f) < tree::kMostForks + 40);
      if (which != some_huge) costs_are_the_least(f);
      if (which == two_places) {
        CHECK(f.left->box.half_area() == 0.0f && f.right->box.half_area() == 0.0f);
      }
    }
    CHECK(alike(*top[0], *top[1]));
  }
}

// Those of a half that lie next to the cut, many of them at the same place as others.
void what_lies_next_to_a_cut_is_brought_there() {
  for (u32 turn = 0; turn < 200; ++turn) {
    const size_t n = 20 + turn % 100, count = 1 + turn % 15;
    std::vector<Ref> refs(n);
    for (u32 i = 0; i < n; ++i) {
      const float at = static_cast<float>(baseline::mix(1000 * turn + i) % 64);
      for (u32 k = 0; k < 3; ++k) refs[i].low[k] = refs[i].high[k] = k == 1 ? at : 0.0f;
      refs[i].id = i;
    }
    for (const bool left : {true, false}) {
      std::vector<Ref> brought = refs, in_order = refs;
      tree::bring_to_cut(tree::measure(brought.data(), n), left, 1, count);
      std::sort(in_order.begin(), in_order.end(),
                [](const Ref& a, const Ref& b) { return a.low[1] < b.low[1]; });
      const size_t cut = left ? n - count : count;
      const auto along = [](const Ref& r) { return r.low[1]; };
      std::vector<float> ours, sorted;
      std::transform(brought.begin(), brought.end(), std::back_inserter(ours), along);
      std::transform(in_order.begin(), in_order.end(), std::back_inserter(sorted), along);
      const auto middle = static_cast<std::ptrdiff_t>(cut);
      std::sort(ours.begin(), ours.begin() + middle);
      std::sort(ours.begin() + middle, ours.end());
      CHECK(ours == sorted);
      std::vector<bool> seen(n, false);
      for (const Ref& r : brought) seen[r.id] = true;
      CHECK(std::find(seen.begin(), seen.end(), false) == seen.end());
    }
  }
}

// Small boxes above and below, and a few that span everything, which cuts leave among those.
void forks_go_where_they_cost_less() {
  constexpr u32 kCount = 6000, kLarge = 200;
  std::vector<Ref> refs(kCount);
  for (u32 i = 0; i < kCount; ++i) {
    const bool large = i < kLarge;
    for (u32 k = 0; k < 3; ++k) {
      const float at = static_cast<float>(baseline::mix(3 * i + k) >> 40) * 0x1p-24f;
      const bool spans = large && k != i % 3;
      refs[i].low[k] = spans ? 0.1f * at : at;
      refs[i].high[k] = spans ? 1.0f - 0.1f * at : at + 0.003f;
    }
    refs[i].id = i;
  }
  const tree::Part whole = tree::measure(refs.data(), kCount);
  const tree::Upkeep upkeep = tree::upkeep_of(whole, false);
  for (const bool together : {false, true}) {
    tree::ForkRoom room(kCount);
    tree::Fork& top = tree::fork(whole, upkeep, 0, room);
    std::vector<bool> before_seen(kCount, false), seen(kCount, false);
    const double before = surface_below(top, before_seen);
    const float cost = top.cost[0];
    if (together) {
      tree::Reinsertion::run_together(top, 2);
    } else {
      tree::Reinsertion::run(top, 2);
    }
    CHECK(surface_below(top, seen) < 0.92 * before && top.cost[0] < 0.995f * cost);
    CHECK(std::find(seen.begin(), seen.end(), false) == seen.end());
    CHECK(top.size == kCount && top.parent == nullptr);
    costs_are_the_least(top);
  }
}

// Random boxes fill theirs; those along its diagonal, or all in one place, leave most of it empty.
void parts_fill_their_boxes_or_not() {
  std::vector<Ref> refs(4096);
  for (const u32 free_axes : {3u, 1u, 0u}) {
    for (u32 i = 0; i < refs.size(); ++i) {
      for (u32 k = 0; k < 3; ++k) {
        const u32 number = free_axes == 3 ? 3 * i + k : free_axes == 1 ? i : 0;
        refs[i].low[k] = static_cast<float>(baseline::mix(number) >> 40) * 0x1p-24f;
        refs[i].high[k] = refs[i].low[k] + 0.001f;
      }
      refs[i].id = i;
    }
    const tree::Part part = tree::measure(refs.data(), refs.size());
    CHECK(tree::leaves_room(part) == (free_axes < 3));
  }
}

// What fits into a leaf is two where these are much smaller than both, as at two ends of a scene.
void leaves_become_two_where_that_costs_less() {
  for (const bool apart : {false, true}) {
    std::vector<Ref> refs(16);
    for (u32 i = 0; i < 16; ++i) {
      for (u32 k = 0; k < 3; ++k) {
        const float at = static_cast<float>(baseline::mix(3 * i + k) >> 40) * 0x1p-24f;
        refs[i].low[k] = apart ? static_cast<float>(i % 2) + 0.01f * at : at;
        refs[i].high[k] = refs[i].low[k] + 0.001f;
      }
      refs[i].id = i;
    }
    tree::ForkRoom room(16);
    const tree::Part part = tree::measure(refs.data(), refs.size());
    const tree::Fork& f = tree::fork(part, {0.0f, 1.0f}, 0, room);
    CHECK((f.left != nullptr) == apart);
    if (apart) CHECK(f.left->size == 8 && f.right->size == 8 && f.cost[1] < f.cost[0]);
  }
}

// A leaf that is full before a node of the same box, that before one which is empty, and lanes
// without children at the other end.
void any_hit_looks_where_it_is_worth_it() {
  Node node;
  for (u32 lane = 0; lane < 16; ++lane) {
    for (u32 k = 0; k < 3; ++k) {
      const bool there = lane == 3 || lane == 7 || lane == 11;
      node.low[k][lane] = there ? 0.0f : kInfinity;
      node.high[k][lane] = there ? 1.0f : -kInfinity;
    }
    node.child[lane] = 100 + lane;
  }
  const auto of = [](int lane) {
    if (lane == 3) return tree::Expected{0.5f, 1.0f};
    return lane == 7 ? tree::Expected{0.25f, 4.0f} : tree::Expected{0.5f, 4.0f};
  };
  const tree::Expected e = tree::put_in_order(node, of);
  CHECK(node.child[15] == 103 && node.child[14] == 111 && node.child[13] == 107);
  for (int lane = 0; lane < 16; ++lane) CHECK(tree::is_there(node, lane) == (lane > 12));
  // All rays that meet the node meet each child: 1 + 1 + 4 / 2 + 4 / 4, of which 3 / 16 hit
  // nothing.
  CHECK(std::abs(e.visits - 5.0f) < 1e-5f && std::abs(e.hit - 13.0f / 16.0f) < 1e-5f);

  // Half the surface of a box, within itself; a hundredth of that, in one a hundred times as large.
  Ref box{{0, 0, 0}, 0, {1, 1, 1}, 0}, far{{9, 9, 9}, 1, {10, 10, 10}, 0};
  const tree::Expected one = tree::expected_of(&box, &box + 1);
  const Ref both[] = {box, far};
  const tree::Expected two = tree::expected_of(both, both + 2);
  CHECK(std::abs(one.hit - 1.0f / 3.0f) < 1e-6f && one.visits == 1.0f);
  CHECK(std::abs(two.hit - 1.0f / 101.0f) < 1e-6f && two.visits == 1.0f);
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

// Clusters within clusters, each of a quarter of the size, so that large parts lie deeper than
// where nodes are made by costs: each primitive is in one leaf.
void deep_trees_lose_nothing() {
  constexpr u32 kCount = 60000;
  std::vector<double> centers, radii;
  u32 state = 0;
  const auto next = [&] { return static_cast<double>(baseline::mix(++state) >> 11) * 0x1p-53; };
  for (u32 i = 0; i < kCount; ++i) {
    double size = 1.0;
    for (u32 k = 0; k < 25 && next() < 0.95; ++k) size *= 0.25;
    for (u32 k = 0; k < 3; ++k) centers.push_back(size * next());
    radii.push_back(std::max(0.001 * size * next(), 2e-15));
  }
  ShapeInput spheres;
  spheres.count = kCount;
  spheres.arrays = {{"centers", centers.data(), true, false, 3},
                    {"radii", radii.data(), true, false, 1}};
  const Scene scene(input_of({spheres}, Cloud::materials()));
  const SceneView& view = scene.view();
  std::vector<u32> seen(kCount, 0);
  for (u32 block = 0; block < view.sphere_blocks; ++block) {
    for (const u32 id : view.spheres[block].id) {
      if (id < kCount) ++seen[id];
    }
  }
  CHECK(std::count(seen.begin(), seen.end(), 1u) == kCount);
}

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
  const Hit tree = ask(scene, {ray}, true).hits[0], brute = ask(scene, {ray}, false).hits[0];
  CHECK(tree.slot.leaf != kNone && tree.t == brute.t && tree.slot.leaf == brute.slot.leaf);
}

}  // namespace

int main() {
  trees_cost_what_lines_meet();
  partitions_keep_their_order();
  several_threads_sort_as_one_does();
  shared_forks_hold_all();
  what_lies_next_to_a_cut_is_brought_there();
  forks_go_where_they_cost_less();
  parts_fill_their_boxes_or_not();
  leaves_become_two_where_that_costs_less();
  any_hit_looks_where_it_is_worth_it();
  trees_do_not_depend_on_threads();
  deep_trees_lose_nothing();
  hard_cases_build();
  return finished("tree");
}
