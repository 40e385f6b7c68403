// Tests of trees: what they cost, how they are divided, by how many threads, and of hard cases.
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "../../core/traverse.h"
#include "../../host/bins.h"
#include "../../host/partition.h"
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
  several_threads_divide_as_one_does();
  trees_do_not_depend_on_threads();
  hard_cases_build();
  return finished("tree");
}
