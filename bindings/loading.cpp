#include "loading.h"

#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "../loading/normals.h"
#include "../loading/numbers.h"
#include "../loading/obj.h"
#include "../loading/polygons.h"
#include "../loading/rows.h"
#include "arrays.h"
#include "lock.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

using Text = nb::ndarray<const unsigned char, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Words = nb::ndarray<const u32, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Triangles = nb::ndarray<const u32, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const u32, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class Real>
using Points = nb::ndarray<const Real, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

std::string_view view(const Text& text) {
  return {reinterpret_cast<const char*>(text.data()), text.shape(0)};
}

// Indices and counts are of 32 bits.
template <class Array>
u32 rows_of(const Array& a) {
  if (a.shape(0) > kNone / 4) throw std::invalid_argument("more rows than a mesh can have");
  return static_cast<u32>(a.shape(0));
}

nb::object numbers(const Text& text) {
  std::vector<double> values;
  {
    const Unlocked unlocked;
    values = parse_numbers(view(text));
  }
  return adopt(std::move(values));
}

nb::tuple distinct(const Words& rows) {
  DistinctRows found;
  {
    const u32 n = rows_of(rows);
    const Unlocked unlocked;
    found = distinct_rows(rows.data(), n, static_cast<u32>(rows.shape(1)));
  }
  return nb::make_tuple(adopt(std::move(found.which)), adopt(std::move(found.first)));
}

template <class Real>
nb::tuple shading(const Points<Real>& vertices, const Triangles& faces,
                  std::optional<double> crease) {
  ShadedMesh mesh;
  {
    const u32 n = rows_of(vertices), f = rows_of(faces);
    const Unlocked unlocked;
    mesh = shade(vertices.data(), n, faces.data(), f, crease);
  }
  float* normals;
  nb::object array = make_array<float>({mesh.normals.size(), 3}, normals);
  for (const Vec3& n : mesh.normals) *normals++ = n.x, *normals++ = n.y, *normals++ = n.z;
  return nb::make_tuple(adopt(std::move(mesh.faces), 3), adopt(std::move(mesh.old)), array);
}

nb::object polygons(const Points<double>& vertices, const Column& counts, const Column& corners) {
  u64 total = 0;
  for (size_t i = 0; i < counts.shape(0); ++i) {
    if (counts.data()[i] < 3) throw std::invalid_argument("a polygon needs at least 3 corners");
    total += counts.data()[i];
  }
  if (total != corners.shape(0)) throw std::invalid_argument("counts do not fit corners");
  for (size_t i = 0; i < corners.shape(0); ++i) {
    if (corners.data()[i] >= vertices.shape(0)) throw std::out_of_range("a vertex is not there");
  }
  std::vector<u32> places;
  {
    const u32 n = rows_of(counts);
    const Unlocked unlocked;
    places = triangulate(vertices.data(), counts.data(), n, corners.data());
  }
  return adopt(std::move(places), 3);
}

nb::dict obj(const Text& text) {
  ObjText found;
  {
    const Unlocked unlocked;
    found = parse_obj(view(text));
  }
  nb::list statements;
  for (const ObjStatement& s : found.statements) {
    statements.append(nb::make_tuple(s.polygon, nb::bytes(s.word.data(), s.word.size()),
                                     nb::bytes(s.rest.data(), s.rest.size())));
  }
  nb::dict d;
  d["positions"] = adopt(std::move(found.positions), 3);
  d["uvs"] = adopt(std::move(found.uvs), 2);
  d["normals"] = adopt(std::move(found.normals), 3);
  d["colors"] = adopt(std::move(found.colors), 3);
  d["sizes"] = adopt(std::move(found.sizes));
  d["corners"] = adopt(std::move(found.corners), found.width);
  d["statements"] = statements;
  nb::list unknown;
  for (const std::string& word : found.unknown) unknown.append(nb::str(word.data(), word.size()));
  d["unknown"] = unknown;
  return d;
}

}  // namespace

void bind_loading(nb::module_& m) {
  nb::exception<ObjError>(m, "ObjError", PyExc_ValueError);
  m.def("numbers", &numbers, "text"_a);
  m.def("distinct_rows", &distinct, "rows"_a);
  m.def("shading", &shading<float>, "vertices"_a, "faces"_a, "crease"_a.none());
  m.def("shading", &shading<double>, "vertices"_a, "faces"_a, "crease"_a.none());
  m.def("polygons", &polygons, "vertices"_a, "counts"_a, "corners"_a);
  m.def("obj", &obj, "text"_a);
}

}  // namespace parhelion
