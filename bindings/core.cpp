// parhelion._core: the host for Python, thin. Arrays are checked here for their form and by the
// host for their numbers; the GIL is released wherever it computes.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <tuple>

#include "../host/errors.h"
#include "../host/kernels.h"
#include "../host/render.h"
#include "../host/scene.h"
#include "../host/view.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

using AnyArray = nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu>;
using FloatRows = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using FloatPairs = nb::ndarray<const float, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Floats = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const u32, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Triple = std::array<float, 3>;
using DTriple = std::array<double, 3>;

// A new NumPy array that owns its data.
template <class T>
nb::object make_array(std::vector<size_t> shape, T*& data) {
  size_t size = 1;
  for (size_t n : shape) size *= n;
  auto owned = std::make_unique<T[]>(size == 0 ? 1 : size);
  data = owned.get();
  nb::capsule owner(owned.release(), [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, T>(data, shape.size(), shape.data(), owner));
}

Vec3 to_vec3(const Triple& v) { return {v[0], v[1], v[2]}; }
const Vec3* vectors(const FloatRows& a) { return reinterpret_cast<const Vec3*>(a.data()); }

// --- The lists of the core ---------------------------------------------------------------------

template <class Entry>
nb::dict describe(const char* name) {
  nb::list params;
  for (const ParamInfo& p : Entry::params) {
    nb::list preset;
    for (int i = 0; i < p.size; ++i) preset.append(p.preset[i]);
    nb::dict d;
    d["name"] = p.name;
    d["size"] = p.size;
    d["default"] = preset;
    d["low"] = p.low;
    d["high"] = p.high;
    d["doc"] = p.doc;
    params.append(d);
  }
  nb::dict d;
  d["name"] = name;
  d["doc"] = Entry::doc;
  d["params"] = params;
  return d;
}

nb::dict tables() {
  nb::list materials, backgrounds, samplers, filters, warps, shapes;
#define MATERIAL(name, Type) materials.append(describe<baseline::Type>(#name));
#include "../core/materials.def"
#undef MATERIAL
#define LIGHT(name, Type) backgrounds.append(describe<baseline::Type>(#name));
#include "../core/lights.def"
#undef LIGHT
#define SHAPE(name, Type) shapes.append(#name);
#include "../core/shapes.def"
#undef SHAPE
  const auto row = [](const char* name, const char* doc) {
    nb::dict d;
    d["name"] = name;
    d["doc"] = doc;
    return d;
  };
#define SAMPLER(name, text) samplers.append(row(#name, text));
#include "../core/samplers.def"
#undef SAMPLER
#define FILTER(id, label, default_radius, text) \
  {                                             \
    nb::dict d = row(label, text);              \
    d["radius"] = default_radius;               \
    filters.append(d);                          \
  }
#include "../core/filters.def"
#undef FILTER
#define WARP(name, has_parameter, text)   \
  {                                       \
    nb::dict d = row(#name, text);        \
    d["parameter"] = bool(has_parameter); \
    warps.append(d);                      \
  }
#include "../core/warps.def"
#undef WARP
  nb::dict all;
  all["materials"] = materials;
  all["backgrounds"] = backgrounds;
  all["shapes"] = shapes;
  all["samplers"] = samplers;
  all["filters"] = filters;
  all["warps"] = warps;
  return all;
}

// --- Scene -------------------------------------------------------------------------------------

// (kind, values): a block as flatten.py makes it.
using BlockTuple = std::tuple<u32, std::vector<float>>;

ParamBlock to_block(const BlockTuple& t) {
  ParamBlock block{};
  block.kind = std::get<0>(t);
  const std::vector<float>& values = std::get<1>(t);
  if (values.size() > kBlockFloats) throw SceneError("a parameter block is too long");
  std::copy(values.begin(), values.end(), block.value);
  return block;
}

bool is_double(const AnyArray& a, const char* name) {
  if (a.dtype() == nb::dtype<double>()) return true;
  if (a.dtype() == nb::dtype<float>()) return false;
  throw nb::type_error((std::string(name) + " must be float32 or float64").c_str());
}

// (name, centers, radii, material index or (N,) uint32, colors or None)
using GroupTuple = std::tuple<std::string, AnyArray, AnyArray, u32, std::optional<Indices>,
                              std::optional<FloatRows>>;

SphereGroup to_group(const GroupTuple& t) {
  const auto& [name, centers, radii, material, material_of, colors] = t;
  SphereGroup g;
  g.name = name;
  if (centers.ndim() != 2 || centers.shape(1) != 3) throw nb::type_error("centers must be (N, 3)");
  g.count = centers.shape(0);
  g.centers = centers.data();
  g.centers_double = is_double(centers, "centers");
  g.radii = radii.data();
  g.radii_double = is_double(radii, "radii");
  g.one_radius = radii.ndim() == 0;
  if (!g.one_radius && (radii.ndim() != 1 || radii.shape(0) != g.count)) {
    throw nb::type_error("radii must be (N,) or a single number");
  }
  g.material = material;
  if (material_of) {
    if (material_of->shape(0) != g.count) throw nb::type_error("material must be (N,)");
    g.material_of = material_of->data();
  }
  if (colors) {
    if (colors->shape(0) != g.count) throw nb::type_error("colors must be (N, 3)");
    g.colors = colors->data();
  }
  return g;
}

nb::dict scene_stats(const Scene& scene) {
  nb::dict d;
  d["spheres"] = scene.sphere_count();
  d["nodes"] = scene.node_count();
  d["leaves"] = scene.block_count();
  d["lights"] = scene.emitter_count();
  d["bytes"] = scene.memory();
  d["scale"] = scene.scale();
  return d;
}

// Rays in the user's units: origins and unit directions; t comes back in the user's units.
std::vector<Ray> to_rays(const Scene& scene, const FloatRows& origins,
                         const FloatRows& directions) {
  if (origins.shape(0) != directions.shape(0)) {
    throw nb::type_error("as many origins as directions are needed");
  }
  const float scale = static_cast<float>(scene.scale());
  std::vector<Ray> rays(origins.shape(0));
  for (size_t i = 0; i < rays.size(); ++i) {
    const Vec3 o = vectors(origins)[i];
    rays[i] = {{o.x * scale, o.y * scale, o.z * scale}, vectors(directions)[i], kNoSlot, false};
  }
  return rays;
}

std::tuple<nb::object, nb::object> intersect(const Scene& scene, const FloatRows& origins,
                                             const FloatRows& directions, bool tree,
                                             const std::string& isa) {
  const std::vector<Ray> rays = to_rays(scene, origins, directions);
  const std::vector<float> limit(rays.size(), kInfinity);
  const Kernels& k = kernels(isa);
  std::vector<Hit> hits(rays.size());
  float* t;
  i64* id;
  nb::object ts = make_array<float>({rays.size()}, t);
  nb::object ids = make_array<i64>({rays.size()}, id);
  nb::gil_scoped_release unlocked;
  k.intersect(scene.view(), rays.data(), limit.data(), rays.size(), tree, hits.data());
  const float unscale = static_cast<float>(1.0 / scene.scale());
  for (size_t i = 0; i < hits.size(); ++i) {
    const Slot slot = hits[i].slot;
    const bool hit = slot.leaf != kNone;
    t[i] = hits[i].t * unscale;
    id[i] = hit ? i64{scene.view().spheres[slot.leaf & kLeafIndexMask].id[slot.lane]} : -1;
  }
  return {ts, ids};
}

nb::object occluded(const Scene& scene, const FloatRows& origins, const FloatRows& directions,
                    const Floats& limits, bool tree, const std::string& isa) {
  const std::vector<Ray> rays = to_rays(scene, origins, directions);
  if (limits.shape(0) != rays.size()) throw nb::type_error("a limit is needed for each ray");
  const float scale = static_cast<float>(scene.scale());
  std::vector<float> limit(limits.data(), limits.data() + rays.size());
  for (float& x : limit) x *= scale;
  u8* out;
  nb::object result = make_array<u8>({rays.size()}, out);
  const Kernels& k = kernels(isa);
  nb::gil_scoped_release unlocked;
  k.occluded(scene.view(), rays.data(), limit.data(), rays.size(), tree, out);
  return result;
}

// --- View and film -----------------------------------------------------------------------------

// What make_view needs besides the scene; see Settings in scene.py for the terms.
RenderView make_view(const Scene& scene, const DTriple& eye, const DTriple& target,
                     const DTriple& up, double fov, double vfov, double aperture_radius,
                     double focus_distance, u32 width, u32 height, const std::string& filter,
                     double filter_radius, const std::string& sampler, u64 seed, u32 max_depth,
                     bool roulette, bool tree) {
  if (width == 0 || height == 0) throw SceneError("width and height must be at least 1");
  CameraInput c{};
  std::copy(eye.begin(), eye.end(), c.eye);
  std::copy(target.begin(), target.end(), c.target);
  std::copy(up.begin(), up.end(), c.up);
  c.fov = fov;
  c.vfov = vfov;
  c.aperture_radius = aperture_radius;
  c.focus_distance = focus_distance;
  return {make_camera(c, width, height, scene.scale(), scene.view().bounds),
          make_filter(filter, filter_radius),
          sampler_kind(sampler),
          seed,
          max_depth,
          roulette,
          tree};
}

Schedule schedule_of(const std::string& name) {
  if (name == "dynamic") return Schedule::dynamic_;
  if (name == "static") return Schedule::static_;
  if (name == "guided") return Schedule::guided;
  throw SceneError("unknown schedule '" + name + "' (choices: dynamic, static, guided)");
}

std::tuple<u64, u64, bool> render(Film& film, const Scene& scene, const RenderView& view, u32 first,
                                  u32 last, int threads, u32 tile, const std::string& schedule,
                                  const std::string& isa, nb::object tick) {
  if (threads < 1) throw SceneError("threads must be at least 1");
  if (tile < 1) throw SceneError("tile must be at least 1");
  RenderOptions options;
  options.threads = threads;
  options.tile = tile;
  options.schedule = schedule_of(schedule);
  const Kernels& k = kernels(isa);
  // Runs on the calling thread, so signals are heard here. An error stops the pass and is thrown
  // on after it: nothing may be thrown through OpenMP.
  std::exception_ptr error;
  const Tick on_tick = [&](u64 samples, u64 rays) {
    nb::gil_scoped_acquire locked;
    try {
      if (PyErr_CheckSignals() != 0) throw nb::python_error();
      return !tick.is_none() && nb::cast<bool>(tick(samples, rays));
    } catch (...) {
      error = std::current_exception();
      return true;
    }
  };
  PassResult result;
  {
    nb::gil_scoped_release unlocked;
    result = render_pass(k, scene, view, film, first, last, options, on_tick);
  }
  if (error) std::rethrow_exception(error);
  return {result.samples, result.rays, result.complete};
}

// (means (h, w, 3), samples per pixel (h, w), samples that were not finite (h, w))
std::tuple<nb::object, nb::object, nb::object> film_arrays(const Film& film) {
  float* rgb;
  u32 *count, *bad;
  nb::object means = make_array<float>({film.height, film.width, 3}, rgb);
  nb::object counts = make_array<u32>({film.height, film.width}, count);
  nb::object bads = make_array<u32>({film.height, film.width}, bad);
  film.means(rgb);
  for (const FilmPixel& p : film.pixels) {
    *count++ = p.count;
    *bad++ = p.bad;
  }
  return {means, counts, bads};
}

Triple one_sample(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                  const std::string& isa) {
  const Vec3 c = kernels(isa).radiance(scene.view(), view, x, y, sample);
  return {c.x, c.y, c.z};
}

// --- The sampling routines, for the statistical tests --------------------------------------------

WarpKind warp_kind(const std::string& name) {
#define WARP(id, parameter, doc) \
  if (name == #id) return WarpKind::id;
#include "../core/warps.def"
#undef WARP
  throw SceneError("unknown warp '" + name + "'");
}

nb::object warp(const std::string& name, float parameter, const FloatPairs& u) {
  Vec3* out;
  float* floats;
  nb::object result = make_array<float>({u.shape(0), 3}, floats);
  out = reinterpret_cast<Vec3*>(floats);
  kernels().warp(warp_kind(name), parameter, reinterpret_cast<const Vec2*>(u.data()), u.shape(0),
                 out);
  return result;
}

nb::object warp_pdf(const std::string& name, float parameter, const FloatRows& w) {
  float* out;
  nb::object result = make_array<float>({w.shape(0)}, out);
  kernels().warp_pdf(warp_kind(name), parameter, vectors(w), w.shape(0), out);
  return result;
}

// (directions, weights, densities, is delta)
std::tuple<nb::object, nb::object, nb::object, nb::object> bsdf_sample(const BlockTuple& material,
                                                                       const Triple& wo, u64 seed,
                                                                       u64 n) {
  std::vector<BsdfProbe> probes(n);
  kernels().bsdf_sample(to_block(material), to_vec3(wo), seed, n, probes.data());
  float *wi, *weight, *pdf;
  u8* delta;
  nb::object wis = make_array<float>({n, 3}, wi), weights = make_array<float>({n, 3}, weight);
  nb::object pdfs = make_array<float>({n}, pdf), deltas = make_array<u8>({n}, delta);
  for (size_t i = 0; i < n; ++i) {
    std::memcpy(wi + 3 * i, &probes[i].wi, sizeof(Vec3));
    std::memcpy(weight + 3 * i, &probes[i].weight, sizeof(Vec3));
    pdf[i] = probes[i].pdf;
    delta[i] = probes[i].delta != 0;
  }
  return {wis, weights, pdfs, deltas};
}

// (values f |cos| (N, 3), densities (N,))
std::tuple<nb::object, nb::object> bsdf_eval(const BlockTuple& material, const Triple& wo,
                                             const FloatRows& wi) {
  float *value, *pdf;
  nb::object values = make_array<float>({wi.shape(0), 3}, value);
  nb::object pdfs = make_array<float>({wi.shape(0)}, pdf);
  kernels().bsdf_eval(to_block(material), to_vec3(wo), vectors(wi), wi.shape(0),
                      reinterpret_cast<Vec3*>(value), pdf);
  return {values, pdfs};
}

// Directions towards the lights as seen from a point in user's units: (directions, distances in
// normalised units, densities)
std::tuple<nb::object, nb::object, nb::object> light_sample(const Scene& scene, const Triple& from,
                                                            u64 seed, u64 n) {
  if (scene.emitter_count() == 0) throw SceneError("the scene has no lights to sample");
  const float scale = static_cast<float>(scene.scale());
  std::vector<LightProbe> probes(n);
  kernels().light_sample(scene.view(), {from[0] * scale, from[1] * scale, from[2] * scale}, seed, n,
                         probes.data());
  float *direction, *distance, *pdf;
  nb::object directions = make_array<float>({n, 3}, direction);
  nb::object distances = make_array<float>({n}, distance), pdfs = make_array<float>({n}, pdf);
  for (size_t i = 0; i < n; ++i) {
    std::memcpy(direction + 3 * i, &probes[i].direction, sizeof(Vec3));
    distance[i] = probes[i].distance;
    pdf[i] = probes[i].pdf;
  }
  return {directions, distances, pdfs};
}

nb::object draws(const std::string& sampler, u32 x, u32 y, u32 first, u64 n, u32 dimension,
                 u64 seed) {
  float* out;
  nb::object result = make_array<float>({n, 2}, out);
  kernels().draws(sampler_kind(sampler), x, y, first, n, dimension, seed,
                  reinterpret_cast<Vec2*>(out));
  return result;
}

nb::object filter_offsets(const std::string& filter, double radius, const Floats& u) {
  float* out;
  nb::object result = make_array<float>({u.shape(0)}, out);
  kernels().filter_offsets(make_filter(filter, radius), u.data(), u.shape(0), out);
  return result;
}

// The filter's value, not normalised, at offsets in pixels.
std::vector<double> filter_values(const std::string& filter, double radius,
                                  const std::vector<double>& x) {
  make_filter(filter, radius);  // checks the arguments
  std::vector<double> values;
  for (double offset : x) {
#define FILTER(id, label, own_radius, doc)                                                 \
  if (filter == label) {                                                                   \
    values.push_back(baseline::filter_value(FilterKind::id, offset,                        \
                                            radius == 0.0 ? double(own_radius) : radius)); \
  }
#include "../core/filters.def"
#undef FILTER
  }
  return values;
}

}  // namespace
}  // namespace parhelion

NB_MODULE(_core, m) {
  using namespace parhelion;
  m.doc() = "The renderer's compiled half; use the parhelion package instead.";

  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const SceneError& e) {
      PyErr_SetString(nb::module_::import_("parhelion.errors").attr("SceneError").ptr(), e.what());
    }
  });

  nb::class_<Scene>(m, "Scene", "Spheres, checked, in a tree.")
      .def("__init__",
           [](Scene* self, const std::vector<GroupTuple>& groups,
              const std::vector<BlockTuple>& materials, const BlockTuple& background) {
             std::vector<SphereGroup> sphere_groups;
             for (const GroupTuple& g : groups) sphere_groups.push_back(to_group(g));
             std::vector<ParamBlock> blocks;
             for (const BlockTuple& b : materials) blocks.push_back(to_block(b));
             const ParamBlock light = to_block(background);
             nb::gil_scoped_release unlocked;
             new (self) Scene(sphere_groups, std::move(blocks), light);
           })
      .def("stats", &scene_stats)
      .def("intersect", &intersect, "origins"_a, "directions"_a, "tree"_a = true, "isa"_a = "")
      .def("occluded", &occluded, "origins"_a, "directions"_a, "limits"_a, "tree"_a = true,
           "isa"_a = "")
      .def("light_sample", &light_sample, "origin"_a, "seed"_a, "n"_a);

  nb::class_<RenderView>(m, "View", "A camera and settings, checked.");
  m.def("make_view", &make_view, "scene"_a, nb::kw_only(), "eye"_a, "target"_a, "up"_a, "fov"_a,
        "vfov"_a, "aperture_radius"_a, "focus_distance"_a, "width"_a, "height"_a, "filter"_a,
        "filter_radius"_a, "sampler"_a, "seed"_a, "max_depth"_a, "roulette"_a, "tree"_a);

  nb::class_<Film>(m, "Film", "The sums of a rectangle of the picture.")
      .def(nb::init<u32, u32, u32, u32>(), "x"_a, "y"_a, "width"_a, "height"_a)
      .def("render", &render, "scene"_a, "view"_a, "first"_a, "last"_a, nb::kw_only(), "threads"_a,
           "tile"_a, "schedule"_a, "isa"_a, "tick"_a.none())
      .def("arrays", &film_arrays);
  m.def("one_sample", &one_sample, "scene"_a, "view"_a, "x"_a, "y"_a, "sample"_a, "isa"_a = "");

  m.def("tables", &tables);
  m.def("instruction_sets", &instruction_sets);
  m.def("instruction_set", [] { return std::string(kernels().name); });
  // OpenMP's threads do not survive a fork, and a child that waits for them hangs.
  nb::object os = nb::module_::import_("os");
  if (nb::hasattr(os, "register_at_fork")) {
    os.attr("register_at_fork")("before"_a = nb::cpp_function(&release_threads));
  }

  m.def("warp", &warp, "name"_a, "parameter"_a, "u"_a);
  m.def("warp_pdf", &warp_pdf, "name"_a, "parameter"_a, "w"_a);
  m.def("bsdf_sample", &bsdf_sample, "material"_a, "wo"_a, "seed"_a, "n"_a);
  m.def("bsdf_eval", &bsdf_eval, "material"_a, "wo"_a, "wi"_a);
  m.def("draws", &draws, "sampler"_a, "x"_a, "y"_a, "first"_a, "n"_a, "dimension"_a, "seed"_a);
  m.def("filter_offsets", &filter_offsets, "filter"_a, "radius"_a, "u"_a);
  m.def("filter_values", &filter_values, "filter"_a, "radius"_a, "x"_a);
}
