// Tests of the light tree, the distributions and every light of lights.def, without Python.
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "../../core/emitter.h"
#include "../../core/light.h"
#include "../../core/random.h"
#include "../../host/distribution.h"
#include "../../host/light_tree.h"
#include "../../host/sky.h"
#include "check.h"

namespace {

using namespace parhelion;
using namespace parhelion::baseline;

// Fails unless a is b but for a relative error.
void near(const char* what, double a, double b, double tolerance) {
  if (std::abs(a - b) <= tolerance * std::abs(b)) return;
  std::printf("%s: %.9g, not %.9g within %g\n", what, a, b, tolerance);
  ++failures;
}

u64 state = 1;
u32 random_bits() {
  state += 0x9e3779b97f4a7c15ull;
  return static_cast<u32>(mix(state) >> 32);
}
float uniform() { return to_unit(random_bits()); }
Vec2 uniform2() { return {uniform(), uniform()}; }
// As long as what chooses lights.
double long_uniform() { return light_number(uniform(), uniform()); }
Vec3 random_direction() { return uniform_sphere(uniform2()); }
Vec3 random_point() { return {uniform(), uniform(), uniform()}; }

// Chi-square statistic as a normal deviate (Wilson and Hilferty, 1931). Cells that expect fewer
// than five are taken together.
double chi_square(const std::vector<double>& expected, const std::vector<double>& observed) {
  double sum = 0, rest_expected = 0, rest_observed = 0, cells = -1;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (expected[i] < 5) {
      rest_expected += expected[i], rest_observed += observed[i];
      continue;
    }
    sum += (observed[i] - expected[i]) * (observed[i] - expected[i]) / expected[i];
    ++cells;
  }
  if (rest_expected >= 5) {
    sum += (rest_observed - rest_expected) * (rest_observed - rest_expected) / rest_expected;
    ++cells;
  } else if (rest_observed > 30) {
    return 1e9;
  }
  if (cells < 1) return 0;
  const double k = 2.0 / (9.0 * cells);
  return (std::cbrt(sum / cells) - (1.0 - k)) / std::sqrt(k);
}

// --- The light tree
// -------------------------------------------------------------------------------

struct Triangles {
  struct One {
    Vec3 a, b, c, normal;
  };
  std::vector<One> all;
  std::vector<LightLeaf> leaves;

  Triangles(size_t n, float size) {
    for (size_t i = 0; i < n; ++i) {
      const Vec3 center = random_point();
      One t = {center + random_direction() * size,
               center + random_direction() * size,
               center + random_direction() * size,
               {}};
      const Vec3 p = t.b - t.a, q = t.c - t.a;
      const Vec3 cross = {p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x};
      t.normal = normalize(cross);
      all.push_back(t);
      LightLeaf leaf{};
      leaf.bounds.low = {min(t.a.x, min(t.b.x, t.c.x)), min(t.a.y, min(t.b.y, t.c.y)),
                         min(t.a.z, min(t.b.z, t.c.z))};
      leaf.bounds.high = {max(t.a.x, max(t.b.x, t.c.x)), max(t.a.y, max(t.b.y, t.c.y)),
                          max(t.a.z, max(t.b.z, t.c.z))};
      leaf.axis = t.normal;
      leaf.cos_o = 1.0f;
      leaf.power = 0.5f * length(cross) * (i % 97 == 0 ? 100.0f : 1.0f + uniform());
      leaves.push_back(leaf);
    }
  }

  Vec3 point(size_t i) const {
    const One& t = all[i];
    const float s = baseline::sqrt(uniform()), b = uniform();
    return t.a * (1.0f - s) + t.b * (s * (1.0f - b)) + t.c * (s * b);
  }
};

int depth_of(const LightTree& tree, u32 light) {
  int depth = 0;
  for (u32 slot = tree.slot_of_light[light]; slot != kNone; slot = tree.slot_of_node[slot >> 4]) {
    ++depth;
  }
  return depth;
}

void tree_chooses_as_it_says() {
  for (size_t n : {1u, 2u, 16u, 17u, 300u, 20000u}) {
    const Triangles lights(n, 0.5f / std::cbrt(static_cast<float>(n)));
    const LightTree tree = build_light_tree(lights.leaves);
    const LightTreeView view = tree.view();
    CHECK(view.light_count == n);
    int deepest = 0;
    for (u32 i = 0; i < n; ++i) deepest = std::max(deepest, depth_of(tree, i));
    // Sixteen to a node at best; twice the logarithm and one to spare.
    CHECK(deepest <= 1 + 2 * std::log(static_cast<double>(n)) / std::log(16.0));
    for (int k = 0; k < 6; ++k) {
      const Receiver at = {random_point(), k % 2 ? random_direction() : Vec3{0, 0, 0}};
      const Highlight glossy = {random_direction(), 0.9f, std::exp2(8.0f * uniform())};
      const Highlight highlight = k < 3 ? kNoHighlight : glossy;
      std::vector<double> expected(n + 1), observed(n + 1);
      const int draws = 40000;
      double sum = 0;
      for (u32 i = 0; i < n; ++i) {
        const double p = light_probability(view, i, at, highlight);
        sum += p;
        expected[i] = draws * p;
      }
      CHECK(sum < 1.0 + 1e-5);
      expected[n] = draws * std::max(0.0, 1.0 - sum);  // a cluster whose lights are all dark
      if (expected[n] < 0.5) expected[n] = 0;
      double low = 0;
      for (int i = 0; i < draws; ++i) {
        const LightChoice c = choose_light(view, at, highlight, long_uniform());
        observed[c.light == kNone ? n : c.light] += 1;
        if (c.light == kNone) continue;
        CHECK(c.probability == light_probability(view, c.light, at, highlight));
        CHECK(c.u >= 0.0f && c.u < 1.0f);
        low += c.u < 0.25f;
      }
      CHECK(chi_square(expected, observed) < 5.0);
      const double chosen = draws - observed[n];
      CHECK(std::abs(low - 0.25 * chosen) <= 5.0 * std::sqrt(0.1875 * chosen));
    }
  }
}

// With lights that shine to all sides none is dark, so probabilities sum to 1.
void tree_probabilities_sum_to_one() {
  Triangles lights(5000, 0.01f);
  for (LightLeaf& l : lights.leaves) l.cos_o = -1.0f;
  const LightTree tree = build_light_tree(lights.leaves);
  for (int k = 0; k < 5; ++k) {
    const Vec3 from = random_point() * 3.0f;
    double sum = 0;
    for (u32 i = 0; i < 5000; ++i)
      sum += light_probability(tree.view(), i, {from, {0, 0, 0}}, kNoHighlight);
    near("sum of probabilities", sum, 1.0, 1e-5);
  }
}

// Points in front of a light, often on its horizon or nearly touching it, seen from surfaces that
// face it, however little.
void tree_loses_no_light() {
  const Triangles lights(1000, 0.05f);
  const LightTree tree = build_light_tree(lights.leaves);
  int seen = 0, lost = 0;
  for (int k = 0; k < 400000; ++k) {
    const u32 i = random_bits() % 1000u;
    const Vec3 on = lights.point(i), normal = lights.all[i].normal;
    Vec3 away = random_direction();
    if (k % 2) away = normalize(away - normal * dot(away, normal) + normal * (1e-5f * uniform()));
    const Vec3 from = on + away * std::exp2(-16.0f * uniform());
    const Vec3 to = on - from;
    Vec3 facing = random_direction();
    if (k % 3 == 0) facing = normalize(facing - to * (dot(facing, to) / dot(to, to)) + to * 1e-4f);
    if (!(dot(to, normal) < 0.0f) || !(dot(to, facing) > 0.0f)) continue;
    ++seen;
    const Highlight highlight = {random_direction(), 0.99f,
                                 std::exp2(std::floor(28.0f * uniform()))};
    const Highlight any = k % 5 ? kNoHighlight : highlight;
    lost += !(light_probability(tree.view(), i, {from, facing}, any) > 0.0f);
  }
  CHECK(seen > 100000);
  CHECK(lost == 0);
}

void tree_does_not_depend_on_threads_or_degeneracy() {
  const Triangles lights(200000, 0.001f);
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const LightTree a = build_light_tree(lights.leaves);
  omp_set_num_threads(3);
  const LightTree b = build_light_tree(lights.leaves);
  omp_set_num_threads(threads);
  CHECK(a.nodes.size() == b.nodes.size());
  CHECK(std::memcmp(a.nodes.data(), b.nodes.data(), a.nodes.size() * sizeof(LightNode)) == 0);
  CHECK(a.slot_of_light == b.slot_of_light && a.slot_of_node == b.slot_of_node);

  // All in one place, along a line, and most of them dark.
  for (int kind = 0; kind < 3; ++kind) {
    std::vector<LightLeaf> leaves(5000);
    for (size_t i = 0; i < leaves.size(); ++i) {
      const float x = kind == 1 ? 1e-3f * static_cast<float>(i) : 0.5f;
      leaves[i] = {{{x, 0.5f, 0.5f}, {x, 0.5f, 0.5f}}, {0, 0, 1}, -1.0f, 1.0f,
                   kind == 2 && i != 77 ? 0.0f : 1.0f, 0};
    }
    const LightTree tree = build_light_tree(leaves);
    double sum = 0;
    for (u32 i = 0; i < leaves.size(); ++i) {
      CHECK(depth_of(tree, i) <= kMaxLightDepth);
      sum += light_probability(tree.view(), i, {{0.5f, 0.5f, 0.5f}, {0, 0, 1}}, kNoHighlight);
    }
    near("sum where lights coincide", sum, 1.0, 1e-5);
    if (kind != 2) continue;
    CHECK(choose_light(tree.view(), {{0, 0, 0}, {0, 0, 0}}, kNoHighlight, 0.99).light == 77);
  }
  const LightTree none = build_light_tree({});
  CHECK(choose_light(none.view(), {{0, 0, 0}, {0, 0, 0}}, kNoHighlight, 0.5).light == kNone);
  const LightTree dark = build_light_tree(std::vector<LightLeaf>(40));
  CHECK(choose_light(dark.view(), {{0, 0, 1}, {0, 0, 0}}, kNoHighlight, 0.5).light == kNone);
}

// Sixteen points at once choose what each does by itself, to the bit: also where a surface sees no
// light, and in media, which have no side.
void few_lights_are_chosen_together() {
  int chosen = 0, none = 0;
  for (size_t n = 1; n <= 16; ++n) {
    Triangles lights(n, 0.2f);
    if (n > 2) lights.leaves[n / 2].power = 0.0f;
    const LightTree tree = build_light_tree(lights.leaves);
    const LightTreeView view = tree.view();
    for (int round = 0; round < 200; ++round) {
      Rows<Receiver, 16> at;
      Rows<Highlight, 16> highlight = {};
      double number[16];
      for (u32 i = 0; i < 16; ++i) {
        at.set(i, Receiver{random_point() * (round % 3 == 0 ? 3.0f : 1.0f),
                           i % 4 == 0 ? Vec3{0, 0, 0} : random_direction()});
        if (round % 2 == 0 && i % 3 == 0) {
          const float gloss = i % 2 ? 1.0f : uniform();
          highlight.set(i, Highlight{random_direction(), gloss, std::exp2(20.0f * uniform())});
        }
        number[i] = i == 1 ? 1.0 - 0x1p-48 : long_uniform();
      }
      u32 light[16];
      float probability[16], u[16];
      choose_lights(view, at, highlight, round % 2 == 0, number, light, probability, u);
      for (u32 i = 0; i < 16; ++i) {
        const LightChoice c = choose_light(view, at.at(i), highlight.at(i), number[i]);
        CHECK(light[i] == c.light);
        CHECK(c.light == kNone || (probability[i] == c.probability && u[i] == c.u));
        ++(c.light == kNone ? none : chosen);
      }
    }
  }
  CHECK(chosen > 10000 && none > 100);
}

// Lights from outside: sixteen numbers choose what each chooses alone, as often as it is said, and
// what is left of them is spread evenly.
void outside_lights_are_chosen_together() {
  constexpr u32 kFirst = 2, kLights = 4, kRounds = 20000;
  const float shares[kLights] = {0.1f, 0.5f, 0.15f, 0.25f};
  LightRecord lights[kFirst + kLights] = {};
  for (u32 i = 0; i < kLights; ++i) lights[kFirst + i].share = shares[i];
  SceneView scene = {};
  scene.lights = lights;
  scene.outside_first = kFirst;
  scene.smooth_first = kFirst + kLights;
  for (const float outside : {1.0f, 0.625f}) {
    scene.outside_share = outside;
    double taken[kLights] = {}, left[kLights] = {};
    u32 below = 0;
    for (u32 round = 0; round < kRounds; ++round) {
      double number[16];
      for (double& n : number) n = long_uniform();
      OutsideChoice<16> chosen;
      choose_outside(scene, number, chosen);
      for (u32 i = 0; i < 16; ++i) {
        if (!(number[i] < static_cast<double>(outside))) continue;
        const LightPick alone = pick_light(scene, {{0, 0, 0}, {0, 0, 0}}, kNoHighlight, number[i]);
        const LightPick pick = chosen.pick(scene, i);
        CHECK(pick.record == alone.record && pick.u == alone.u);
        CHECK(pick.probability == alone.probability);
        CHECK(pick.probability == outside * shares[pick.record - kFirst]);
        CHECK(pick.u >= 0.0f && pick.u < 1.0f);
        taken[pick.record - kFirst] += 1.0;
        left[pick.record - kFirst] += static_cast<double>(pick.u);
        ++below;
      }
    }
    for (u32 i = 0; i < kLights; ++i) {
      near("outside light taken", taken[i] / below, static_cast<double>(shares[i]), 0.03);
      near("what is left of its numbers", left[i] / taken[i], 0.5, 0.02);
    }
  }
}

// Each of 64 consecutive samples has its own 64th of the numbers that choose lights. So what is
// left of them on either of two lights leaves no gap of more than two of these.
void light_numbers_stay_even() {
  for (int round = 0; round < 20; ++round) {
    const Triangles lights(2, 0.2f);
    std::vector<LightLeaf> leaves = lights.leaves;
    for (LightLeaf& l : leaves) l.cos_o = -1.0f;  // seen from everywhere
    const LightTree tree = build_light_tree(leaves);
    const Vec3 from = random_point();
    std::vector<float> left[2];
    for (u32 i = 0; i < 64; ++i) {
      const Sampler s = make_sampler(SamplerKind::sobol, 3, 5, i, static_cast<u64>(round));
      const double number = light_number(draw2(s, kDrawLightPoint).x, draw1(s, kDrawLight));
      const LightChoice c = choose_light(tree.view(), {from, {0, 0, 0}}, kNoHighlight, number);
      left[c.light].push_back(c.u);
    }
    for (u32 i = 0; i < 2; ++i) {
      const float widest =
          2.0f / (64.0f * light_probability(tree.view(), i, {from, {0, 0, 0}}, kNoHighlight));
      std::sort(left[i].begin(), left[i].end());
      float before = 0.0f;
      for (const float u : left[i]) {
        CHECK(u - before <= widest * 1.0001f);
        before = u;
      }
      CHECK(1.0f - before <= widest * 1.0001f);
    }
  }
}

// What microfacets mirror of few small lights and of many: the mean square of a sample falls where
// it is asked for by the highlight.
void highlights_find_what_mirrors_show() {
  for (size_t n : {6u, 2000u}) {
    Triangles lights(n, 0.02f / std::cbrt(static_cast<float>(n)));
    for (LightLeaf& l : lights.leaves) l.cos_o = -1.0f;  // seen from everywhere
    const LightTree tree = build_light_tree(lights.leaves);
    double square[2] = {0, 0};
    for (int k = 0; k < 60; ++k) {
      const Receiver at = {random_point(), {0, 0, 0}};
      const Highlight shown = {random_direction(), 0.99f, 100.0f};
      for (u32 i = 0; i < n; ++i) {
        const Vec3 d = lights.point(i) - at.point;
        const double c = static_cast<double>(dot(d, shown.direction) / length(d));
        const double fall = 0.5 * ((1.0 + c) + (1.0 - c) * 100.0);
        const double sent = static_cast<double>(lights.leaves[i].power / dot(d, d)) / (fall * fall);
        for (int with = 0; with < 2; ++with) {
          const Highlight highlight = with ? shown : kNoHighlight;
          square[with] += sent * sent / light_probability(tree.view(), i, at, highlight);
        }
      }
    }
    CHECK(square[1] < (n > 100 ? 0.3 : 0.9) * square[0]);
  }
}

// Irradiance from many lights, whose relative deviation at one sample must grow far slower than
// their number, and stay below that of picking by power.
void tree_beats_power() {
  double deviation[2][2];
  for (int big = 0; big < 2; ++big) {
    const size_t n = big ? 100000 : 100;
    const Triangles lights(n, 0.3f / std::cbrt(static_cast<float>(n)));
    const LightTree tree = build_light_tree(lights.leaves);
    std::vector<double> cumulative;
    double total = 0;
    for (const LightLeaf& l : lights.leaves) cumulative.push_back(total += l.power);
    double ratio[2] = {0, 0};
    const int points = 40, draws = 4000;
    for (int k = 0; k < points; ++k) {
      const Vec3 from = random_point(), normal = random_direction();
      const auto sent = [&](size_t i) {
        const Vec3 d = lights.point(i) - from;
        const double r2 = dot(d, d);
        const double cosines = std::max(0.0f, -dot(d, lights.all[i].normal)) *
                               static_cast<double>(std::max(0.0f, dot(d, normal))) / r2;
        return lights.leaves[i].power * cosines / r2;
      };
      double sum[2] = {0, 0}, square[2] = {0, 0};
      for (int i = 0; i < draws; ++i) {
        const LightChoice c =
            choose_light(tree.view(), {from, normal}, kNoHighlight, long_uniform());
        const double x = c.light == kNone ? 0.0 : sent(c.light) / c.probability;
        const size_t p = static_cast<size_t>(
            std::lower_bound(cumulative.begin(), cumulative.end(), total * uniform()) -
            cumulative.begin());
        const double y = sent(p) * total / lights.leaves[p].power;
        sum[0] += x, square[0] += x * x, sum[1] += y, square[1] += y * y;
      }
      for (int s = 0; s < 2; ++s) {
        const double mean = sum[s] / draws;
        if (mean > 0) ratio[s] += std::sqrt(square[s] / draws - mean * mean) / mean;
      }
    }
    deviation[big][0] = ratio[0] / points, deviation[big][1] = ratio[1] / points;
  }
  CHECK(deviation[0][0] < 0.6 * deviation[0][1]);
  CHECK(deviation[1][0] < 0.3 * deviation[1][1]);
  CHECK(deviation[1][0] < 2.0 * deviation[0][0]);
}

// --- Distributions
// --------------------------------------------------------------------------------

void distributions_keep_every_weight() {
  const std::vector<double> weights = {0, 1e9, 0, 1e-9, 0, 0, 0, 0, 1, 0, 1, 0, NAN, 0, -1, 1e-3};
  const DistributionTable table(4, 4, weights);
  const Distribution d = table.view();
  double sum = 0;
  for (u32 i = 0; i < 16; ++i) {
    const float p = cell_probability(d, i % 4, i / 4);
    CHECK((p > 0.0f) == (weights[i] > 0.0));
    sum += p;
  }
  near("sum of cells", sum, 1.0, 1e-6);
  near("of two equal cells", cell_probability(d, 0, 2), cell_probability(d, 2, 2), 1e-6);
  Vec2 before = {0, 0};
  for (int i = 0; i < 100000; ++i) {
    const Vec2 u = i == 0 ? Vec2{0, 0} : i == 1 ? Vec2{0x1.fffffep-1f, 0x1.fffffep-1f} : uniform2();
    const CellSample s = sample_cell(d, u);
    CHECK(s.probability == cell_probability(d, s.x, s.y) && s.probability > 0.0f);
    CHECK(s.u.x >= 0.0f && s.u.x < 1.0f && s.u.y >= 0.0f && s.u.y < 1.0f);
  }
  const std::vector<double> same(7 * 5, 2.0);
  const DistributionTable even(7, 5, same);
  for (int i = 0; i < 1000; ++i) {  // the identity, cell by cell
    const Vec2 u = {static_cast<float>(i) * 1e-3f, 0.3f};
    const CellSample s = sample_cell(even.view(), u);
    const Vec2 at = {(static_cast<float>(s.x) + s.u.x) / 7, (static_cast<float>(s.y) + s.u.y) / 5};
    CHECK(std::abs(at.x - u.x) < 1e-5f && std::abs(at.y - u.y) < 1e-5f);
    CHECK(i == 0 || at.x > before.x);
    before = at;
  }
  // The cell is that in whose share the number lies, on both axes.
  for (u32 width = 1; width < 40; ++width) {
    const u32 height = 41 - width;
    std::vector<double> wild(size_t{width} * height);
    for (double& w : wild) w = uniform2().x < 0.3f ? 0.0 : std::exp(30.0 * uniform2().x);
    const DistributionTable found(width, height, wild);
    const Distribution f = found.view();
    const auto scanned = [](const u32* starts, u32 count, float u) {
      const u64 place = static_cast<u64>(u * 0x1p24f) * kDistributionWhole >> 24;
      u32 i = count - 1;
      while (starts[i] > place) --i;
      return i;
    };
    for (int i = 0; i < 200; ++i) {
      const Vec2 u = i == 0   ? Vec2{0, 0}
                     : i == 1 ? Vec2{0x1.fffffep-1f, 0x1.fffffep-1f}
                              : uniform2();
      const CellSample s = sample_cell(f, u);
      CHECK(s.y == scanned(f.rows, height, u.y));
      CHECK(s.x == scanned(f.columns + size_t{s.y} * width, width, u.x));
    }
  }
  const DistributionTable black(3, 2, std::vector<double>(6, 0.0));
  near("black", cell_probability(black.view(), 1, 1), 1.0 / 6, 1e-6);
}

// --- Lights
// ---------------------------------------------------------------------------------------

// One light with the tables that it needs. Its image is what the renderer would give it, or noise.
struct Bench {
  LightRecord record{};
  std::vector<float> texels;
  ImageView image{};
  std::vector<DistributionTable> table;
  Distribution distribution{};

  Bench(LightKind kind, std::vector<float> values, bool turned = true) {
    record.block.kind = static_cast<u32>(kind);
    std::copy(values.begin(), values.end(), record.block.value);
    const Frame f = frame_around(turned ? normalize(Vec3{0.3f, -0.5f, 0.7f}) : Vec3{0, 0, 1});
    const float m[9] = {f.x.x, f.y.x, f.z.x, f.x.y, f.y.y, f.z.y, f.x.z, f.y.z, f.z.z};
    std::copy(m, m + 9, record.to_world);
    if (turned) record.position = {0.1f, 0.2f, 0.3f};
    bool square = false;
    if (kind == LightKind::sky) {
      const Sky s = from_block<Sky>(record.block);
      set_image(kSkyWidth, kSkyHeight, sky_image(s.sun_direction, s.turbidity, s.albedo));
    } else if (kind == LightKind::sun) {
      const Sun s = from_block<Sun>(record.block);
      const Vec3 c = sun_radiance(s.sun_direction, s.turbidity, s.angle);
      set_image(1, 1, {c.x, c.y, c.z});
    } else {
      square = kind == LightKind::envmap && values[3] == 1.0f;
      const u32 width = square ? 16 : 24, height = square ? 16 : 12;
      std::vector<float> noise(static_cast<size_t>(width) * height * 3);
      for (float& x : noise) x = uniform() * uniform() * 4.0f;
      for (size_t i = 30; i < 60; ++i) noise[i] = 0.0f;
      set_image(width, height, noise);
    }
    set_distribution(square);
  }

  void set_image(u32 width, u32 height, std::vector<float> values) {
    texels = std::move(values);
    image.texels = texels.data();
    image.width = width, image.height = height;
    image.levels = 1;
    image.format = ImageFormat::float32;
    image.channels = 3;
  }
  void set_distribution(bool square) {
    table.clear();
    table.push_back(square ? equal_area_distribution(image) : latlong_distribution(image));
    distribution = table[0].view();
  }

  LightTables tables() const { return {&image, &distribution}; }
  LightSample sample(Vec3 from, Vec2 u) const { return sample_light(record, tables(), from, u); }
  Vec3 radiance(Vec3 d) const { return light_radiance(record, tables(), d); }
  LightSight seen(Vec3 d) const { return light_seen(record, tables(), d); }
  float pdf(Vec3 d) const { return seen(d).pdf; }
};

// A light's parameters as preset.
std::vector<float> presets(LightKind kind) {
  ParamBlock block{};
  block.kind = static_cast<u32>(kind);
  return with_light(block, []<class Light>(const Light&) {
    std::vector<float> values;
    for (const ParamInfo& p : Light::params) {
      for (int i = 0; i < p.size; ++i) values.push_back(p.preset[i]);
    }
    CHECK(values.size() * sizeof(float) == sizeof(Light));
    return values;
  });
}

// Whether light is asked for by the cells of an image.
bool has_cells(const Bench& light) {
  const auto kind = static_cast<LightKind>(light.record.block.kind);
  return kind == LightKind::envmap || kind == LightKind::sky;
}

// Of panoramas, by latitude and longitude, in directions at random and along the axes.
void sixteen_see_what_each_sees(const Bench& light) {
  const Envmap envmap = from_block<Envmap>(light.record.block);
  for (u32 i = 0; i < 200; ++i) {
    Rows<Vec3, 16> direction;
    for (u32 k = 0; k < 16; ++k) {
      const Sampler s = make_sampler(SamplerKind::independent, 1, 2, 16 * i + k, 3);
      const float sign = k & 1 ? 1.0f : -1.0f;
      const Vec3 axes[3] = {{sign, 0, 0}, {0, sign, 0}, {0, 0, sign}};
      direction.set(k, i == 0 ? axes[k / 2 % 3] : uniform_sphere(draw2(s, 0)));
    }
    const u32 lanes = i == 0 ? 0xffffu : i * 0x9e3779b9u >> 16;
    const u32 weighed = i % 3 == 0 ? lanes : i % 3 == 1 ? lanes & (i >> 1) : 0;
    Rows<LightSight, 16> sights;
    const bool can = seen(envmap, light.record, light.tables(), lanes, weighed, direction, sights);
    CHECK(can == is_latlong(envmap));
    for_each_bit(can ? lanes : 0, [&](u32 k) {
      const LightSight one = light.seen(direction.at(k)), together = sights.at(k);
      CHECK(std::memcmp(&one.radiance, &together.radiance, sizeof one.radiance) == 0);
      CHECK((weighed >> k & 1u) == 0 || one.pdf == together.pdf);
    });
  }
}

// Samples fall as their density says, the density integrates to 1 over what shines, samples carry
// the radiance that a ray sees, and all of it is found but what panoramas leave to scattering,
// which is less than half of the mean.
void outside_light_is_sampled_rightly(const std::string& name, const Bench& light) {
  constexpr int kHeights = 20, kTurns = 40, kFine = 24, kDraws = 200000;
  std::vector<double> expected(kHeights * kTurns), observed(expected.size());
  double total = 0, energy = 0, left = 0, unasked = 0;
  const double cell = 4.0 * kPi / (kHeights * kTurns) / (kFine * kFine);
  for (int i = 0; i < kHeights * kFine; ++i) {
    for (int j = 0; j < kTurns * kFine; ++j) {
      const Vec3 d = direction_at((static_cast<float>(i) + 0.5f) * 2.0f / (kHeights * kFine),
                                  (static_cast<float>(j) + 0.5f) / (kTurns * kFine));
      const double p = light.pdf(d);
      expected[static_cast<size_t>(i / kFine * kTurns + j / kFine)] += kDraws * p * cell;
      total += p * cell;
      (p > 0.0 ? energy : left) += luminance(light.radiance(d)) * cell;
      unasked += p > 0.0 ? 0.0 : cell;
    }
  }
  near((name + ": integral of the density").c_str(), total, 1.0, 2e-3);
  CHECK(left == 0.0 || has_cells(light));
  CHECK(left <= 0.5 * (energy + left) / (4.0 * kPi) * unasked);
  if (static_cast<LightKind>(light.record.block.kind) == LightKind::envmap) {
    sixteen_see_what_each_sees(light);
  }
  double sum = 0, square = 0;
  int differs = 0;
  for (int k = 0; k < kDraws; ++k) {
    const LightSample s = light.sample(random_point(), uniform2());
    CHECK(!s.delta && s.distance == kInfinity && s.pdf > 0.0f);
    CHECK(std::abs(length(s.direction) - 1.0f) < 1e-5f);
    const float turn = std::atan2(s.direction.y, s.direction.x) / (2.0f * kPi);
    const int i =
        std::clamp(static_cast<int>((1.0f - s.direction.z) * 0.5f * kHeights), 0, kHeights - 1);
    const int j =
        std::clamp(static_cast<int>((turn < 0 ? turn + 1 : turn) * kTurns), 0, kTurns - 1);
    observed[static_cast<size_t>(i * kTurns + j)] += 1;
    // On the edge of a texel or disk rounding may take the other side.
    const Vec3 seen = light.radiance(s.direction);
    differs += std::abs(light.pdf(s.direction) - s.pdf) > 1e-3f * s.pdf ||
               length(seen - s.radiance) > 1e-3f * length(s.radiance) + 1e-6f;
    CHECK(length(light.seen(s.direction).radiance - seen) == 0.0f);
    const double x = luminance(s.radiance) / s.pdf;
    sum += x, square += x * x;
  }
  const double deviate = chi_square(expected, observed);
  if (!(deviate < 4.5)) std::printf("%s: chi-square deviate %g\n", name.c_str(), deviate);
  CHECK(deviate < 4.5);
  CHECK(differs < kDraws / 1000);
  const double mean = sum / kDraws;
  const double error = std::sqrt(std::max(0.0, square / kDraws - mean * mean) / kDraws);
  if (std::abs(mean - energy) > 5 * error + 3e-3 * energy) {
    std::printf("%s: sampled %g +- %g, integrated %g\n", name.c_str(), mean, error, energy);
    ++failures;
  }
}

void every_light_keeps_its_contract() {
#define LIGHT(name, Type) every_kind.push_back({#name, LightKind::name, Type::outside});
  struct Kind {
    std::string name;
    LightKind kind;
    bool outside;
  };
  std::vector<Kind> every_kind;
#include "../../core/lights.def"
#undef LIGHT
  for (const Kind& k : every_kind) {
    const Bench light(k.kind, presets(k.kind));
    CHECK(is_outside(light.record) == k.outside);
    const Vec3 from = {0.4f, -0.3f, 0.9f};
    const LightSample s = light.sample(from, {0.3f, 0.6f});
    if (k.outside && !s.delta) {
      // The sun is too small for the grid's integrals; a wide one is tested below.
      if (k.kind != LightKind::sun) outside_light_is_sampled_rightly(k.name, light);
      continue;
    }
    for (int i = 0; i < 100; ++i) {
      const Vec3 d = random_direction();
      CHECK(light.pdf(d) == 0.0f && black(light.radiance(d)));
    }
    CHECK(s.delta);
    if (k.outside) continue;
    // The tree must be able to choose the light wherever it shines.
    const LightReach r = light_reach(light.record, light.tables());
    CHECK(r.power > 0.0f);
    const LightTree tree =
        build_light_tree({{{r.position, r.position}, r.axis, r.cos_o, r.cos_e, r.power, 0}});
    int lit = 0;
    for (int i = 0; i < 20000; ++i) {
      const Vec3 at = random_direction() * (3.0f * uniform());
      const LightSample t = light.sample(at, {0, 0});
      if (!(t.pdf > 0.0f)) continue;
      ++lit;
      CHECK(t.delta && t.pdf == 1.0f && !black(t.radiance));
      CHECK(length(at + t.direction * t.distance - r.position) < 1e-5f);
      CHECK(light_probability(tree.view(), 0, {at, {0, 0, 0}}, kNoHighlight) == 1.0f);
      const Vec3 twice = r.position + (at - r.position) * 2.0f;
      const float here = luminance(t.radiance),
                  there = luminance(light.sample(twice, {0, 0}).radiance);
      const float most = r.power / (t.distance * t.distance);  // at a cone's edge, little of that
      CHECK(std::abs(4.0f * there - here) <= 1e-3f * here + 1e-4f * most);
    }
    CHECK(lit > 100);
    CHECK(light.sample(r.position, {0, 0}).pdf == 0.0f);
  }
  outside_light_is_sampled_rightly("directional, wide",
                                   Bench(LightKind::directional, {2, 3, 4, 0.2f, 0.5f, -0.7f, 60}));
  outside_light_is_sampled_rightly("sun, wide",
                                   Bench(LightKind::sun, {1, 1, 1, 0.2f, 0.5f, -0.7f, 3, 50}));
  outside_light_is_sampled_rightly("equal area", Bench(LightKind::envmap, {1, 2, 1, 1}));
  outside_light_is_sampled_rightly("gradient, black below",
                                   Bench(LightKind::gradient, {0, 0, 0, 1, 1, 1, 1, 2, 3}));
}

// Irradiance of a light from outside on a surface with a normal: of panoramas, whose samples leave
// some of it out, by what is seen.
double irradiance(const Bench& light, Vec3 normal, int n) {
  const Frame frame = frame_around(normal);
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    const Vec2 u = {(static_cast<float>(i) + 0.5f) / static_cast<float>(n),
                    to_unit(reverse_bits(static_cast<u32>(i)))};
    if (has_cells(light)) {
      sum += luminance(light.radiance(to_world(frame, cosine_hemisphere(u)))) * kPi;
      continue;
    }
    const LightSample s = light.sample({0, 0, 0}, u);
    if (!(s.pdf > 0.0f)) continue;  // a pole itself
    sum += luminance(s.radiance) * std::max(0.0f, dot(s.direction, normal)) / s.pdf;
  }
  return sum / n;
}

void lights_give_known_answers() {
  // A constant sky of radiance 1 gives pi; a gradient from 0 to 1 has (1 + cos) / 2: pi (1/2 +
  // 1/3).
  near("constant", irradiance(Bench(LightKind::constant, {1, 1, 1}), {0, 1, 0}, 1 << 16), kPi,
       1e-3);
  const Bench slope(LightKind::gradient, {0, 0, 0, 1, 1, 1, 0, 1, 0}, false);
  near("gradient", irradiance(slope, {0, 1, 0}, 1 << 16), kPi * 5 / 6, 1e-3);

  // A disk gives the irradiance that is asked for, whatever its size, up to the hemisphere.
  for (float angle : {0.0f, 0.01f, 0.53f, 20.0f, 180.0f}) {
    const Bench sun(LightKind::directional, {3, 3, 3, 0, -2, 0, angle}, false);
    near("directional", irradiance(sun, {0, 1, 0}, 1 << 14), 3.0, 1e-3);
  }

  // Two thirds of the way from beam to cutoff a third is left.
  const Bench spot(LightKind::spot, {6, 6, 6, 0, 0, 0, 0, 0, 2, 40, 10}, false);
  for (const auto& [degrees, share] : std::vector<std::pair<float, float>>{
           {0, 1}, {9.9f, 1}, {25, 0.5f}, {30, 1.0f / 3}, {39, 1.0f / 30}, {41, 0}, {170, 0}}) {
    const CosSin a = cos_sin_degrees(degrees);
    const LightSample s = spot.sample({2 * a.s, 0, 2 * a.c}, {0, 0});
    CHECK(std::abs(s.radiance.y - 6.0f / 4 * share) < 1e-5f);
  }

  // A screen at distance z gets pi times the image over z^2, in its middle and in its corners.
  Bench projector(LightKind::projector, {2, 2, 2, 0, 0, 0, 90, 0}, false);
  projector.set_image(4, 2, std::vector<float>(24, 0.25f));
  for (float z : {1.0f, 2.0f}) {
    for (Vec2 p : {Vec2{0, 0}, Vec2{0.97f, 0.48f}, Vec2{-0.97f, -0.2f}}) {
      const LightSample s = projector.sample({p.x * z, p.y * z, z}, {0, 0});
      near("projector", s.radiance.x * -s.direction.z, 0.5 * kPi / (z * z), 1e-5);
    }
    CHECK(projector.sample({1.01f * z, 0, z}, {0, 0}).pdf == 0.0f);
    CHECK(projector.sample({0, 0.51f * z, z}, {0, 0}).pdf == 0.0f);
    CHECK(projector.sample({0, 0, -z}, {0, 0}).pdf == 0.0f);
  }
  // Its left is at +x, its top at +y.
  projector.set_image(2, 2, {1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4});
  const auto corner = [&](float x, float y) {
    const LightSample s = projector.sample({x, y, 1.0f}, {0, 0});
    return s.radiance.x * -s.direction.z / (2.0f * kPi);
  };
  near("top left", corner(0.9f, 0.9f), 1, 1e-5);
  near("top right", corner(-0.9f, 0.9f), 2, 1e-5);
  near("bottom left", corner(0.9f, -0.9f), 3, 1e-5);
  near("bottom right", corner(-0.9f, -0.9f), 4, 1e-5);
}

// Radiance from the envmap of Mitsuba 3.9.1 for the same image.
void envmap_is_laid_out_as_mitsubas() {
  Bench light(LightKind::envmap, {1, 1, 1, 0}, false);
  std::vector<float> texels;
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 8; ++x) {
      for (int c = 0; c < 3; ++c) {
        texels.push_back(static_cast<float>((x * 7 + y * 3 + c * 5) % 11) / 4.0f);
      }
    }
  }
  light.set_image(8, 5, texels);
  light.set_distribution(false);
  const Vec3 known[][2] = {
      {{0.6f, 0.64f, 0.48f}, {1.227697f, 0.7152387f, 0.977697f}},
      {{-0.48f, 0.6f, -0.64f}, {1.23849f, 0.9548318f, 1.326674f}},
      {{0.28f, -0.96f, 0.0f}, {1.228997f, 1.600836f, 0.9789968f}},
      {{-0.8f, -0.36f, 0.48f}, {0.9755927f, 1.039754f, 1.772524f}},
      {{0.0f, 0.28f, -0.96f}, {0.975836f, 0.850836f, 1.603997f}},
  };
  for (const auto& [d, expected] : known) {
    CHECK(length(light.radiance(d) - expected) < 1e-5f);
  }
  // The poles, the seam, and images of one row or column.
  for (const Vec3 d : {Vec3{0, 1, 0}, Vec3{0, -1, 0}, Vec3{-0.0f, 0, -1}, Vec3{0.0f, 0, -1}}) {
    CHECK(finite(light.radiance(d)) && light.pdf(d) >= 0.0f && light.pdf(d) < kInfinity);
  }
  for (const auto& [width, height] : {std::pair<u32, u32>{1, 1}, {1, 3}, {4, 1}}) {
    light.set_image(width, height,
                    std::vector<float>(static_cast<size_t>(width) * height * 3, 2.0f));
    light.set_distribution(false);
    for (int i = 0; i < 100; ++i)
      CHECK(length(light.radiance(random_direction()) - Vec3{2, 2, 2}) < 1e-5f);
    near("one radiance", irradiance(light, {0, 1, 0}, 1 << 14), 2 * kPi, 2e-3);
  }
}

void equal_area_maps_are_inverse() {
  for (int i = 0; i < 100000; ++i) {
    const Vec2 p = uniform2(), q = to_equal_area(from_equal_area(p));
    CHECK(std::abs(p.x - q.x) < 2e-6f && std::abs(p.y - q.y) < 2e-6f);
    const Vec2 a = to_latlong(from_latlong(p));
    const float turn = std::abs(a.x - p.x);
    CHECK(std::min(turn, 1.0f - turn) * cos_sin_turns(0.5f * p.y).s < 1e-6f);
    CHECK(std::abs(a.y - p.y) < 1e-6f);
  }
  CHECK(length(from_equal_area({0.5f, 0.5f}) - Vec3{0, 0, 1}) < 1e-6f);
  CHECK(length(from_equal_area({0.0f, 0.0f}) - Vec3{0, 0, -1}) < 1e-3f);
}

void sky_and_sun_are_physical() {
  const auto sky = [](Vec3 sun, float turbidity, float albedo) {
    return Bench(LightKind::sky, {1, 1, 1, sun.x, sun.y, sun.z, turbidity, albedo}, false);
  };
  const Vec3 up = {0, 1, 0};
  const auto direct = [](Vec3 sun, float turbidity) {
    const CosSin half = cos_sin_degrees(0.5f * 0.533f);
    return luminance(sun_radiance(sun, turbidity, 0.533f)) * kPi * half.s * half.s;
  };
  // Straight through, an optical depth more for each unit of turbidity: that of molecules at 550
  // nm.
  near("extinction", direct(up, 2) / direct(up, 3), std::exp(0.0973), 0.01);
  // What arrives is less than the sun's 133 klx and more without haze; typical clear days have
  // 85 to 105 klx of direct and 8 to 25 of scattered light.
  const Vec3 high = {0.5f, 0.866f, 0.0f};
  const double diffuse = irradiance(sky(high, 2.5f, 0.2f), up, 1 << 16);
  CHECK(diffuse > 8.0 && diffuse < 25.0);
  CHECK(direct(high, 2.5f) > 85.0 && direct(high, 2.5f) < 105.0);
  CHECK(direct(high, 2.5f) * 0.866 + diffuse < 133.0 * 0.866);
  // Pure air loses no light but by ozone and to space.
  CHECK(direct(up, 1) + irradiance(sky(up, 1.0f, 0.0f), up, 1 << 16) < 133.0);
  // Disks of another size give the same light.
  const CosSin wide = cos_sin_degrees(10.0f);
  near("sun's size", luminance(sun_radiance(high, 2.5f, 20.0f)) * kPi * wide.s * wide.s,
       direct(high, 2.5f), 1e-4);

  const Bench noon = sky(high, 2.5f, 0.2f);
  const Vec3 zenith = noon.radiance(up);
  const Vec3 away = noon.radiance(normalize(Vec3{-1, 1.2f, 0}));
  const Vec3 horizon = noon.radiance(normalize(Vec3{-1, 0.09f, 0}));
  CHECK(away.z > 1.5f * away.x);                          // blue
  CHECK(horizon.x / horizon.z > 1.2f * away.x / away.z);  // and paler at the horizon
  CHECK(luminance(noon.radiance(high)) > 3.0f * luminance(zenith));
  // Both sides of the sun's meridian are alike.
  near("mirror", luminance(noon.radiance(normalize(Vec3{0.3f, 0.5f, 0.6f}))),
       luminance(noon.radiance(normalize(Vec3{0.3f, 0.5f, -0.6f}))), 1e-3);
  // The ground reflects its share of all that falls on it.
  near("ground", luminance(noon.radiance({0, -1, 0})),
       0.2 / kPi * (direct(high, 2.5f) * 0.866 + diffuse), 0.01);
  CHECK(black(sky(high, 2.5f, 0.0f).radiance({0, -1, 0})));
  // A red sun sets, and is gone below the horizon, while the sky still glows.
  const Vec3 low = sun_radiance({1, 0.035f, 0}, 2, 0.533f);
  CHECK(low.x > 2.0f * low.y && low.y > low.z);
  CHECK(black(sun_radiance({1, -0.05f, 0}, 2, 0.533f)));
  const float dusk = luminance(sky({1, -0.05f, 0}, 2, 0.2f).radiance(up));
  CHECK(dusk > 0.0f && dusk < 0.1f * luminance(zenith));
}

}  // namespace

int main() {
  tree_chooses_as_it_says();
  tree_probabilities_sum_to_one();
  tree_loses_no_light();
  tree_does_not_depend_on_threads_or_degeneracy();
  few_lights_are_chosen_together();
  outside_lights_are_chosen_together();
  light_numbers_stay_even();
  highlights_find_what_mirrors_show();
  tree_beats_power();
  distributions_keep_every_weight();
  every_light_keeps_its_contract();
  lights_give_known_answers();
  envmap_is_laid_out_as_mitsubas();
  equal_area_maps_are_inverse();
  sky_and_sun_are_physical();
  std::printf(failures == 0 ? "all passed\n" : "%d failed\n", failures);
  return failures == 0 ? 0 : 1;
}
