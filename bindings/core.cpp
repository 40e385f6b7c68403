// parhelion._core: the host for Python, thin. Arrays are checked here for their form and by the
// host for their numbers; the GIL is released wherever it computes.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>
#include <omp.h>

#include <array>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <tuple>
#include <variant>

#include "../host/errors.h"
#include "../host/kernels.h"
#include "../host/render.h"
#include "../host/scene.h"
#include "../host/threads.h"
#include "../host/tree_cost.h"
#include "../host/view.h"
#include "arrays.h"
#include "loading.h"
#include "lock.h"
#include "pixel.h"
#include "rays.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

using FloatPairs = nb::ndarray<const float, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const u32, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Triple = std::array<float, 3>;
using DTriple = std::array<double, 3>;

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
    d["choices"] = p.choices ? p.choices : "";
    params.append(d);
  }
  nb::dict d;
  d["name"] = name;
  d["doc"] = Entry::doc;
  d["params"] = params;
  return d;
}

template <class Entry>
constexpr bool takes_image() {
  if constexpr (requires { Entry::has_image; }) {
    return Entry::has_image;
  } else {
    return false;
  }
}

nb::dict tables() {
  nb::list materials, textures, lights, cameras, samplers, filters, warps, shapes;
#define MATERIAL(name, Type)                               \
  {                                                        \
    nb::dict d = describe<baseline::Type>(#name);          \
    d["transmits"] = baseline::kTransmits<baseline::Type>; \
    materials.append(d);                                   \
  }
#include "../core/materials.def"
#undef MATERIAL
#define TEXTURE(name, Type)                       \
  {                                               \
    nb::dict d = describe<baseline::Type>(#name); \
    d["image"] = takes_image<baseline::Type>();   \
    textures.append(d);                           \
  }
#include "../core/textures.def"
#undef TEXTURE
#define LIGHT(name, Type)                         \
  {                                               \
    nb::dict d = describe<baseline::Type>(#name); \
    d["image"] = takes_image<baseline::Type>();   \
    d["outside"] = baseline::Type::outside;       \
    lights.append(d);                             \
  }
#include "../core/lights.def"
#undef LIGHT
#define SHAPE(name, Type) shapes.append(#name);
#include "../core/shapes.def"
#undef SHAPE
#define CAMERA(name, Type) cameras.append(#name);
#include "../core/cameras.def"
#undef CAMERA
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
  all["textures"] = textures;
  all["lights"] = lights;
  all["cameras"] = cameras;
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

// The entries of a dict as flatten.py makes them; what may be absent is looked for first.
template <class T>
T get(const nb::dict& d, const char* key) {
  return nb::cast<T>(d[key]);
}
template <class T>
T get(const nb::dict& d, const char* key, T otherwise) {
  return d.contains(key) ? nb::cast<T>(d[key]) : otherwise;
}

template <class T>
const T* exact(const nb::dict& d, const char* key, size_t size) {
  if (!d.contains(key)) return nullptr;
  const auto a = nb::cast<nb::ndarray<const T, nb::c_contig, nb::device::cpu>>(d[key]);
  if (a.size() != size) throw nb::type_error((std::string(key) + " has the wrong size").c_str());
  return a.data();
}

// kind -> the arrays of its primitives, in order, and the numbers in a row of each.
struct ArraySpec {
  const char* name;
  int columns;
};
std::vector<ArraySpec> arrays_of(ShapeKind kind) {
  switch (kind) {
    case ShapeKind::sphere: return {{"centers", 3}, {"radii", 1}};
    case ShapeKind::triangle: return {{"vertices", 3}};
    case ShapeKind::disk: return {{"centers", 3}, {"axis_u", 3}, {"axis_v", 3}};
    case ShapeKind::cylinder: return {{"starts", 3}, {"ends", 3}, {"axis_u", 3}, {"radii", 1}};
    case ShapeKind::curve: return {{"points", 12}, {"radii", 4}, {"along", 2}, {"flags", 1}};
    case ShapeKind::instance: return {};
  }
  return {};
}

ShapeKind shape_kind(const std::string& name) {
#define SHAPE(id, Type) \
  if (name == #id) return ShapeKind::id;
#include "../core/shapes.def"
#undef SHAPE
  if (name == "instance") return ShapeKind::instance;
  throw SceneError("unknown kind of shape '" + name + "'");
}

ShapeInput to_shape(const nb::dict& d) {
  ShapeInput s;
  s.kind = shape_kind(get<std::string>(d, "kind"));
  s.name = get<std::string>(d, "name");
  s.count = get<size_t>(d, "count");
  if (s.kind == ShapeKind::instance) {
    s.group = get<u32>(d, "group");
    s.transforms = exact<double>(d, "transforms", 12 * s.count);
    s.colors = exact<float>(d, "colors", 3 * s.count);
    return s;
  }
  s.faces = exact<u32>(d, "faces", 3 * s.count);
  size_t rows = s.count;
  if (s.faces) rows = s.vertex_count = nb::cast<AnyArray>(d["vertices"]).shape(0);
  for (const ArraySpec& spec : arrays_of(s.kind)) {
    s.arrays.push_back(to_numbers(spec.name, nb::cast<AnyArray>(d[spec.name]), spec.columns, rows));
  }
  s.material = get<u32>(d, "material");
  s.material_of = exact<u32>(d, "material_of", s.count);
  s.colors = exact<float>(d, "colors", 3 * s.count);
  s.inside_out = get<bool>(d, "inside_out", false);
  if (const float* r = exact<float>(d, "rotation", 9)) std::copy(r, r + 9, s.rotation);
  s.normals = exact<float>(d, "normals", 3 * s.vertex_count);
  s.uvs = exact<float>(d, "uvs", 2 * s.vertex_count);
  s.tangents = exact<float>(d, "tangents", 4 * s.vertex_count);
  if (d.contains("attributes")) {
    for (nb::handle h : nb::cast<nb::list>(d["attributes"])) {
      const nb::dict a = nb::cast<nb::dict>(h);
      AttributeInput input{};
      input.name = get<u32>(a, "name");
      input.per_face = get<bool>(a, "per_face");
      input.components = get<u32>(a, "components");
      input.rows = input.per_face ? s.count : s.vertex_count;
      input.values = exact<float>(a, "values", input.rows * input.components);
      s.attributes.push_back(input);
    }
  }
  return s;
}

Vec3 to_vec3(const Triple& v) { return {v[0], v[1], v[2]}; }

TextureBinding to_binding(const nb::dict& d) {
  return {get<u32>(d, "texture"), get<u32>(d, "offset"), get<u32>(d, "size"),
          get<u32>(d, "channel"), get<float>(d, "low"),  get<float>(d, "high")};
}

constexpr TextureBinding kNoTexture = {kNone, 0, 0, 0, 0.0f, 0.0f};

// Of a material or texture: appended to all others.
template <class Record>
void add_bindings(const nb::dict& d, Record& record, std::vector<TextureBinding>& bindings) {
  record.first_binding = static_cast<u32>(bindings.size());
  for (nb::handle h : nb::cast<nb::list>(d["bindings"])) {
    bindings.push_back(to_binding(nb::cast<nb::dict>(h)));
    if (++record.binding_count > kBlockFloats) {
      throw SceneError("more textures than parameters that they could stand for");
    }
  }
}

MaterialRecord to_material(const nb::dict& d, std::vector<TextureBinding>& bindings) {
  MaterialRecord m{};
  m.block = to_block(get<BlockTuple>(d, "block"));
  add_bindings(d, m, bindings);
  const auto texture = [&](const char* key) {
    return d.contains(key) ? to_binding(nb::cast<nb::dict>(d[key])) : kNoTexture;
  };
  m.emission = to_vec3(get<Triple>(d, "emission"));
  m.emission_texture = texture("emission_texture").texture;
  m.opacity = get<float>(d, "opacity");
  m.opacity_texture = texture("opacity_texture");
  m.normal_map = texture("normal_map").texture;
  m.bump_map = texture("bump_map").texture;
  m.bump_scale = 1.0f;
  m.blend_first = get<u32>(d, "blend_first", kNone);
  m.blend_second = get<u32>(d, "blend_second", kNone);
  m.blend_weight = get<float>(d, "blend_weight", 0.0f);
  m.blend_texture = texture("blend_texture");
  m.back = get<u32>(d, "back");
  m.priority = get<u32>(d, "priority");
  m.absorption = to_vec3(get<Triple>(d, "absorption"));
  m.emits_back = get<bool>(d, "emits_back");
  m.traits = get<bool>(d, "uses_uv") ? kUsesUv : 0;
  m.normal_right_handed = get<bool>(d, "normal_right_handed");
  return m;
}

TextureRecord to_texture(const nb::dict& d, std::vector<TextureBinding>& bindings) {
  TextureRecord t{};
  t.block = to_block(get<BlockTuple>(d, "block"));
  add_bindings(d, t, bindings);
  const auto to_uv = get<std::array<float, 6>>(d, "to_uv");
  std::copy(to_uv.begin(), to_uv.end(), t.to_uv);
  t.image = get<u32>(d, "image", kNone);
  t.uvs = get<u32>(d, "uvs", kNone);
  return t;
}

ImageInput to_image(const nb::dict& d) {
  const auto a = nb::cast<AnyArray>(d["pixels"]);
  ImageInput image{};
  image.name = get<std::string>(d, "name");
  image.data = a.data();
  if (a.dtype() == nb::dtype<u8>()) {
    image.type = SampleType::uint8;
  } else if (a.dtype() == nb::dtype<unsigned short>()) {
    image.type = SampleType::uint16;
  } else if (a.dtype() == nb::dtype<float>()) {
    image.type = SampleType::float32;
  } else {
    throw nb::type_error("an image must be uint8, uint16 or float32");
  }
  image.height = static_cast<u32>(a.shape(0));
  image.width = static_cast<u32>(a.shape(1));
  image.channels = static_cast<u32>(a.shape(2));
  image.srgb = get<bool>(d, "srgb");
  image.mip = get<bool>(d, "mip");
  return image;
}

LightInput to_light(const nb::dict& d) {
  LightInput l{};
  l.name = get<std::string>(d, "name");
  l.record.block = to_block(get<BlockTuple>(d, "block"));
  const auto rotation = get<std::array<float, 9>>(d, "rotation");
  std::copy(rotation.begin(), rotation.end(), l.record.to_world);
  l.record.position = to_vec3(get<Triple>(d, "position"));
  l.record.image = get<u32>(d, "image", kNone);
  return l;
}

SceneInput to_scene(const nb::dict& d) {
  SceneInput input;
  for (nb::handle group : nb::cast<nb::list>(d["groups"])) {
    GroupInput& shapes = input.groups.emplace_back();
    for (nb::handle s : nb::cast<nb::list>(group)) {
      shapes.push_back(to_shape(nb::cast<nb::dict>(s)));
    }
  }
  for (nb::handle m : nb::cast<nb::list>(d["materials"])) {
    input.materials.push_back(to_material(nb::cast<nb::dict>(m), input.bindings));
  }
  for (nb::handle t : nb::cast<nb::list>(d["textures"])) {
    input.textures.push_back(to_texture(nb::cast<nb::dict>(t), input.bindings));
  }
  for (nb::handle i : nb::cast<nb::list>(d["images"])) {
    input.images.push_back(to_image(nb::cast<nb::dict>(i)));
  }
  for (nb::handle l : nb::cast<nb::list>(d["lights"])) {
    input.lights.push_back(to_light(nb::cast<nb::dict>(l)));
  }
  return input;
}

// The lists "materials" or "lights" of what flatten.py makes, in the place of the scene's.
void set_materials(Scene& scene, const nb::list& listed) {
  std::vector<TextureBinding> bindings;  // as they are: they begin where they began
  std::vector<MaterialRecord> materials;
  for (nb::handle m : listed) {
    materials.push_back(to_material(nb::cast<nb::dict>(m), bindings));
  }
  const Unlocked unlocked;
  scene.set_materials(std::move(materials));
}

void set_lights(Scene& scene, const nb::list& listed) {
  std::vector<LightInput> lights;
  for (nb::handle l : listed) lights.push_back(to_light(nb::cast<nb::dict>(l)));
  const Unlocked unlocked;
  scene.set_lights(std::move(lights));
}

nb::dict scene_stats(const Scene& scene) {
  nb::dict d;
#define SHAPE(name, Type) d[#name "s"] = scene.primitive_count(ShapeKind::name);
#include "../core/shapes.def"
#undef SHAPE
  d["instances"] = scene.primitive_count(ShapeKind::instance);
  d["nodes"] = scene.node_count();
  d["leaves"] = scene.block_count();
  d["lights"] = scene.light_count();
  d["bytes"] = scene.memory();
  d["peak_bytes"] = scene.peak_memory();
  d["scale"] = scene.scale();
  return d;
}

std::tuple<double, double> cost_of_tree(const Scene& scene) {
  const TreeCost cost = tree_cost(scene.view());
  return {cost.nodes, cost.leaves};
}

// --- View and film -----------------------------------------------------------------------------

// What make_view needs besides the scene; see Settings in scene.py for the terms.
RenderView make_view(const Scene& scene, const nb::dict& camera, u32 width, u32 height,
                     const std::string& filter, double filter_radius, const std::string& sampler,
                     u64 seed, u32 max_depth, bool roulette, bool tree,
                     const std::string& integrator, double ao_distance,
                     const std::optional<DTriple>& backdrop, double clamp_indirect,
                     bool reuse_paths) {
  if (width == 0 || height == 0) throw SceneError("width and height must be at least 1");
  CameraInput c{};
  c.projection = get<std::string>(camera, "projection");
  const auto triple = [&](const char* key, double (&into)[3]) {
    const auto v = get<DTriple>(camera, key);
    std::copy(v.begin(), v.end(), into);
  };
  triple("eye", c.eye);
  triple("target", c.target);
  triple("up", c.up);
  c.fov = get<double>(camera, "fov");
  c.vfov = get<double>(camera, "vfov");
  c.aperture_radius = get<double>(camera, "aperture_radius");
  c.focus_distance = get<double>(camera, "focus_distance");
  c.height = get<double>(camera, "height");
  const auto shift = get<std::array<double, 2>>(camera, "shift");
  std::copy(shift.begin(), shift.end(), c.shift);
  c.mirrored = get<bool>(camera, "mirrored");
  RenderView view{make_camera(c, width, height, scene.scale(), scene.view().bounds),
                  make_filter(filter, filter_radius),
                  sampler_kind(sampler),
                  seed,
                  max_depth,
                  roulette,
                  tree,
                  Integrator::path,
                  kInfinity,
                  {std::numeric_limits<float>::quiet_NaN(), 0.0f, 0.0f},
                  {}};
  if (backdrop) {
    view.backdrop = {static_cast<float>((*backdrop)[0]), static_cast<float>((*backdrop)[1]),
                     static_cast<float>((*backdrop)[2])};
  }
  if (clamp_indirect > 0.0) view.clamp_indirect = static_cast<float>(clamp_indirect);
  view.width = width, view.height = height;
  view.reuse_paths = reuse_paths;
  view.media = media_around(scene, c, tree);
  if (integrator == "direct") {
    view.max_depth = std::min(max_depth, 2u);
  } else if (integrator == "ao") {
    view.integrator = Integrator::ambient_occlusion;
    if (ao_distance > 0.0) view.ao_distance = static_cast<float>(ao_distance * scene.scale());
  } else if (integrator != "path") {
    throw SceneError("unknown integrator '" + integrator + "' (choices: path, direct, ao)");
  }
  return view;
}

// The same view with another seed, and with paths that are shared or not.
RenderView but(const RenderView& view, u64 seed, bool reuse_paths) {
  RenderView other = view;
  other.seed = seed, other.reuse_paths = reuse_paths;
  return other;
}

Schedule schedule_of(const std::string& name) {
  if (name == "dynamic") return Schedule::dynamic_;
  if (name == "static") return Schedule::static_;
  if (name == "guided") return Schedule::guided;
  throw SceneError("unknown schedule '" + name + "' (choices: dynamic, static, guided)");
}

using Counts = nb::ndarray<const u32, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Of all pictures so far, by all threads; guarded by the GIL.
double traversal_seconds = 0.0;

// render_pass() with the GIL let go; returns samples, rays, and false if tick stopped it.
std::tuple<u64, u64, bool> render_all(const Scene& scene, std::span<const Part> parts, int threads,
                                      u32 tile, const std::string& schedule, const std::string& isa,
                                      const nb::object& tick) {
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
    const Locked locked;
    try {
      return or_wait_for_the_end([&] {
        if (PyErr_CheckSignals() != 0) throw nb::python_error();
        return !tick.is_none() && nb::cast<bool>(tick(samples, rays));
      });
    } catch (...) {
      error = std::current_exception();
      return true;
    }
  };
  PassResult result;
  {
    const Unlocked unlocked;
    result = render_pass(k, scene, parts, options, on_tick);
  }
  traversal_seconds += result.traversal_seconds;
  if (error) std::rethrow_exception(error);
  return {result.samples, result.rays, result.complete};
}

// targets: samples per pixel, the same for all, by cell, or by pixel.
std::tuple<u64, u64, bool> render(Film& film, const Scene& scene, const RenderView& view,
                                  const std::variant<u32, Counts>& targets, int threads, u32 tile,
                                  const std::string& schedule, const std::string& isa,
                                  nb::object tick) {
  const size_t down = film.cells_down(), across = film.cells_across();
  Targets wanted;
  if (const u32* all = std::get_if<u32>(&targets)) {
    wanted.samples.assign(down * across, *all);
  } else {
    const Counts& given = std::get<Counts>(targets);
    const bool by_cell = given.shape(0) == down && given.shape(1) == across;
    wanted.by_pixel = given.shape(0) == film.height && given.shape(1) == film.width;
    if (!by_cell && !wanted.by_pixel) {
      throw SceneError("targets must be " + std::to_string(down) + " by " + std::to_string(across) +
                       ", for cells, or " + std::to_string(film.height) + " by " +
                       std::to_string(film.width));
    }
    wanted.samples.assign(given.data(), given.data() + given.size());
  }
  const Part whole = {view, film, wanted};
  return render_all(scene, {&whole, 1}, threads, tile, schedule, isa, tick);
}

// Some films, each with its own view, to the same number of samples.
std::tuple<u64, u64, bool> render_films(const Scene& scene,
                                        const std::vector<std::tuple<Film*, RenderView*>>& films,
                                        u32 samples, int threads, u32 tile,
                                        const std::string& schedule, const std::string& isa,
                                        nb::object tick) {
  std::vector<Targets> targets(films.size());
  std::vector<Part> parts;
  for (size_t i = 0; i < films.size(); ++i) {
    const auto& [film, view] = films[i];
    targets[i].samples.assign(size_t{film->cells_down()} * film->cells_across(), samples);
    parts.push_back({*view, *film, targets[i]});
  }
  return render_all(scene, parts, threads, tile, schedule, isa, tick);
}

// Film::begin and Film::add; samples of each pixel.
void begin(Film& film, const Counts& counts) { film.begin({counts.data(), counts.size()}); }
void add_part(Film& film, const Film& part, const Counts& begun) {
  film.add(part, {begun.data(), begun.size()});
}

// Film::errors, (cells down, cells across).
nb::object film_errors(const Film& film) {
  if (film.prefixes.empty()) throw SceneError("the film was made without errors");
  double* out;
  nb::object errors = make_array<double>({film.cells_down(), film.cells_across()}, out);
  film.errors(out);
  return errors;
}

// Film::variances, (h, w).
nb::object film_variances(const Film& film) {
  if (film.prefixes.empty()) throw SceneError("the film was made without errors");
  float* out;
  nb::object variances = make_array<float>({film.height, film.width}, out);
  film.variances(out);
  return variances;
}

// The bytes of the film, for checkpoints: (pixels, features, prefixes), to be read and written.
std::tuple<nb::object, nb::object, nb::object> film_memory(nb::handle_t<Film> self) {
  Film& film = nb::cast<Film&>(self);
  const auto bytes = [&](auto& values) {
    return nb::cast(
        nb::ndarray<nb::numpy, u8>(values.data(), {values.size() * sizeof values[0]}, self));
  };
  return {bytes(film.pixels), bytes(film.features), bytes(film.prefixes)};
}

// (means (h, w, 3), samples per pixel (h, w), samples that were not finite (h, w))
std::tuple<nb::object, nb::object, nb::object> film_arrays(const Film& film) {
  float* rgb;
  u32 *count, *bad;
  nb::object means = make_array<float>({film.height, film.width, 3}, rgb);
  nb::object counts = make_array<u32>({film.height, film.width}, count);
  nb::object bads = make_array<u32>({film.height, film.width}, bad);
  {
    const Unlocked unlocked;
    film.means(rgb);
#pragma omp parallel for schedule(static) if (film.pixels.size() > kFewElements)
    for (size_t i = 0; i < film.pixels.size(); ++i) {
      count[i] = film.pixels[i].count;
      bad[i] = film.pixels[i].bad;
    }
  }
  return {means, counts, bads};
}

// Feature name -> (h, w, channels): means of what the first surfaces look like; lengths times
// `unit`. "shape" and "material" are indices of the first sample's, -1 for none.
nb::dict feature_arrays(const Film& film, double unit) {
  struct Channel {
    const char* name;
    size_t first, size;
    bool place, length;
  };
  static constexpr Channel kChannels[] = {
      {"depth", 0, 1, true, true},      {"position", 1, 3, true, true},
      {"normal", 4, 3, true, false},    {"shading_normal", 7, 3, true, false},
      {"uv", 10, 2, true, false},       {"albedo", 0, 3, false, false},
      {"emission", 3, 3, false, false}, {"direct", 6, 3, false, false},
  };
  nb::dict all;
  std::array<float*, std::size(kChannels)> means;
  for (size_t c = 0; c < means.size(); ++c) {
    all[kChannels[c].name] =
        make_array<float>({film.height, film.width, kChannels[c].size}, means[c]);
  }
  float* coverage;
  i64 *shape, *material;
  all["coverage"] = make_array<float>({film.height, film.width}, coverage);
  all["shape"] = make_array<i64>({film.height, film.width}, shape);
  all["material"] = make_array<i64>({film.height, film.width}, material);
  {
    const Unlocked unlocked;
    // Once over the film, of whose half a kilobyte a pixel little stays in caches.
#pragma omp parallel for schedule(static) if (film.features.size() > kFewElements)
    for (size_t i = 0; i < film.features.size(); ++i) {
      const FeaturePixel& p = film.features[i];
      for (size_t c = 0; c < means.size(); ++c) {
        const Channel& channel = kChannels[c];
        const FilmSum* sums = (channel.place ? p.place : p.light) + channel.first;
        const float factor = channel.length ? static_cast<float>(unit) : 1.0f;
        for (size_t k = 0; k < channel.size; ++k) {
          means[c][i * channel.size + k] =
              factor * baseline::mean(sums[k], channel.place ? p.hits : p.count);
        }
      }
      coverage[i] = p.count == 0 ? 0.0f : static_cast<float>(p.hits) / static_cast<float>(p.count);
      shape[i] = p.shape == kNone ? -1 : i64{p.shape};
      material[i] = p.material == kNone ? -1 : i64{p.material};
    }
  }
  return all;
}

// Cryptomatte's (ranks of shapes, ranks of materials), each (h, w, ranks, 2) of id and coverage.
std::tuple<nb::object, nb::object> matte_arrays(const Film& film, const Indices& shape_ids,
                                                const Indices& material_ids) {
  float *shape, *material;
  nb::object shapes = make_array<float>({film.height, film.width, kMatteRanks, 2}, shape);
  nb::object materials = make_array<float>({film.height, film.width, kMatteRanks, 2}, material);
  {
    const Unlocked unlocked;
    film.ranks(&FeaturePixel::shapes, {shape_ids.data(), shape_ids.size()}, shape);
    film.ranks(&FeaturePixel::materials, {material_ids.data(), material_ids.size()}, material);
  }
  return {shapes, materials};
}

Triple one_sample(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                  const std::string& isa) {
  PathStats stats;
  const Vec3 c = kernels(isa).radiance(scene.view(), view, x, y, sample, stats);
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
                                                                       u64 n,
                                                                       const std::string& sampler) {
  std::vector<BsdfProbe> probes(n);
  kernels().bsdf_sample(to_block(material), to_vec3(wo), sampler_kind(sampler), seed, n,
                        probes.data());
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
// normalised units, densities, radiances)
std::tuple<nb::object, nb::object, nb::object, nb::object> light_sample(const Scene& scene,
                                                                        const Triple& from,
                                                                        u64 seed, u64 n) {
  const float scale = static_cast<float>(scene.scale());
  std::vector<LightProbe> probes(n);
  kernels().light_sample(scene.view(), {from[0] * scale, from[1] * scale, from[2] * scale}, seed, n,
                         probes.data());
  float *direction, *distance, *pdf;
  float* radiance;
  nb::object directions = make_array<float>({n, 3}, direction);
  nb::object distances = make_array<float>({n}, distance), pdfs = make_array<float>({n}, pdf);
  nb::object radiances = make_array<float>({n, 3}, radiance);
  for (size_t i = 0; i < n; ++i) {
    std::memcpy(direction + 3 * i, &probes[i].direction, sizeof(Vec3));
    distance[i] = probes[i].distance;
    pdf[i] = probes[i].pdf;
    std::memcpy(radiance + 3 * i, &probes[i].radiance, sizeof(Vec3));
  }
  return {directions, distances, pdfs, radiances};
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
  check_processor();
  m.doc() = "The renderer's compiled half; use the parhelion package instead.";
  nb::set_leak_warnings(false);  // what threads use when Python ends is no leak to tell users of

  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const SceneError& e) {
      PyErr_SetString(nb::module_::import_("parhelion.errors").attr("SceneError").ptr(), e.what());
    } catch (const ResourceError& e) {
      const nb::object type = nb::module_::import_("parhelion.errors").attr("ResourceError");
      PyErr_SetString(type.ptr(), e.what());
    }
  });

  nb::class_<Scene> scene(m, "Scene", "Shapes, materials and lights, checked, with their trees.");
  scene
      .def(
          "__init__",
          [](Scene* self, const nb::dict& parts, std::optional<u64> memory_limit) {
            SceneInput input = to_scene(parts);
            const Unlocked unlocked;
            new (self) Scene(std::move(input), memory_limit.value_or(~u64{0}));
          },
          "parts"_a, "memory_limit"_a.none() = nb::none())
      .def("set_materials", &set_materials, "materials"_a)
      .def("set_lights", &set_lights, "lights"_a)
      .def("stats", &scene_stats)
      .def("tree_cost", &cost_of_tree)
      .def("light_sample", &light_sample, "origin"_a, "seed"_a, "n"_a);
  bind_rays(m, scene);

  nb::class_<RenderView>(m, "View", "A camera and settings, checked.")
      .def("but", &but, "seed"_a, "reuse_paths"_a);
  m.def("make_view", &make_view, "scene"_a, nb::kw_only(), "camera"_a, "width"_a, "height"_a,
        "filter"_a, "filter_radius"_a, "sampler"_a, "seed"_a, "max_depth"_a, "roulette"_a, "tree"_a,
        "integrator"_a, "ao_distance"_a, "backdrop"_a.none(), "clamp_indirect"_a = 0.0,
        "reuse_paths"_a = false);

  nb::class_<Film>(m, "Film", "The sums of a rectangle of the picture.")
      .def(nb::init<u32, u32, u32, u32, bool, bool>(), "x"_a, "y"_a, "width"_a, "height"_a,
           "features"_a = false, "errors"_a = false, nb::call_guard<Unlocked>())
      .def("render", &render, "scene"_a, "view"_a, "targets"_a, nb::kw_only(), "threads"_a,
           "tile"_a, "schedule"_a, "isa"_a, "tick"_a.none())
      .def("begin", &begin, "counts"_a)
      .def("add", &add_part, "part"_a, "begun"_a)
      .def_ro("x", &Film::x)
      .def_ro("y", &Film::y)
      .def_ro("width", &Film::width)
      .def_ro("height", &Film::height)
      .def_prop_ro("has_features", [](const Film& film) { return !film.features.empty(); })
      .def_prop_ro("has_errors", [](const Film& film) { return !film.prefixes.empty(); })
      .def("errors", &film_errors)
      .def("variances", &film_variances)
      .def("memory", &film_memory)
      .def("arrays", &film_arrays)
      .def("features", &feature_arrays, "unit"_a)
      .def("mattes", &matte_arrays, "shape_ids"_a, "material_ids"_a);
  m.def("render_films", &render_films, "scene"_a, "films"_a, "samples"_a, nb::kw_only(),
        "threads"_a, "tile"_a, "schedule"_a, "isa"_a, "tick"_a.none());
  m.def("one_sample", &one_sample, "scene"_a, "view"_a, "x"_a, "y"_a, "sample"_a, "isa"_a = "");

  m.attr("sources") = PARHELION_SOURCES;  // a hash of what decides over the picture
  m.attr("block") = kBlock;
  m.attr("region") = kRegion;
  m.def("tables", &tables);
  m.def("traversal_seconds", [] { return traversal_seconds; });
  // Of what the calling thread asks for.
  m.def("max_threads", [] { return omp_get_max_threads(); });
  m.def("set_max_threads", [](int count) { omp_set_num_threads(count); }, "count"_a);
  m.def("instruction_sets", &instruction_sets);
  m.def("instruction_set", [] { return std::string(kernels().name); });
  // Clang's OpenMP reads the environment when it is first called, which is to be while __init__.py
  // has its words there.
  omp_get_max_threads();
  // OpenMP's threads do not survive a fork, and a child that waits for them hangs.
  nb::object os = nb::module_::import_("os");
  if (nb::hasattr(os, "register_at_fork")) {
    os.attr("register_at_fork")("before"_a = nb::cpp_function(&release_threads));
  }

  bind_loading(m);
  bind_pixel(m);

  m.def("warp", &warp, "name"_a, "parameter"_a, "u"_a);
  m.def("warp_pdf", &warp_pdf, "name"_a, "parameter"_a, "w"_a);
  m.def("bsdf_sample", &bsdf_sample, "material"_a, "wo"_a, "seed"_a, "n"_a,
        "sampler"_a = "independent");
  m.def("bsdf_eval", &bsdf_eval, "material"_a, "wo"_a, "wi"_a);
  m.def("draws", &draws, "sampler"_a, "x"_a, "y"_a, "first"_a, "n"_a, "dimension"_a, "seed"_a);
  m.def("filter_offsets", &filter_offsets, "filter"_a, "radius"_a, "u"_a);
  m.def("filter_values", &filter_values, "filter"_a, "radius"_a, "x"_a);
}
