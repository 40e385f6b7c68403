// Tests of pictures: the same by every instruction set, number of threads and order of work; stops,
// parts and mistakes.
#include <omp.h>
#if defined(__linux__)
#include <sched.h>
#endif

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include "../../host/samples.h"
#include "../../host/wake_apart.h"
#include "check.h"
#include "cloud.h"

namespace {

using namespace parhelion;

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
          PathStats stats;
          baseline::add(later.pixels[i],
                        kernels(isa).radiance(scene.view(), view, i % 40, i / 40, 0, stats));
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
          baseline::add(sum, k.radiance(scene.view(), view, x, 1, s, stats));
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

}  // namespace

int main() {
  pictures_do_not_depend_on_how_they_are_made(false);
  pictures_do_not_depend_on_how_they_are_made(true);
  groups_are_of_even_rows_or_of_odd_ones();
  batches_are_their_samples();
  samples_that_are_not_finite_are_counted_and_left_out();
  everything_at_once();
  a_pass_can_be_stopped();
  passes_go_on_where_they_stopped();
  parts_made_elsewhere_add_up();
  sums_are_exact_in_any_order();
  mistakes_are_named();
#if defined(__linux__)
  threads_wake_apart_and_are_free_again();
#endif
  return finished("render");
}
