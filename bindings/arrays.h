// NumPy arrays of what C++ has made.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "../host/array.h"
#include "../host/scene.h"

namespace parhelion {

using AnyArray = nanobind::ndarray<nanobind::ro, nanobind::c_contig, nanobind::device::cpu>;
using FloatRows = nanobind::ndarray<const float, nanobind::shape<-1, 3>, nanobind::c_contig,
                                    nanobind::device::cpu>;
using Floats =
    nanobind::ndarray<const float, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;

inline const Vec3* vectors(const FloatRows& a) { return reinterpret_cast<const Vec3*>(a.data()); }

inline bool is_double(const AnyArray& a, const char* name) {
  if (a.dtype() == nanobind::dtype<double>()) return true;
  if (a.dtype() == nanobind::dtype<float>()) return false;
  throw nanobind::type_error((std::string(name) + " must be float32 or float64").c_str());
}

// The rows of an array, or of one that is the same for all.
inline Numbers to_numbers(const char* name, const AnyArray& a, int columns, size_t rows) {
  Numbers n;
  n.name = name;
  n.data = a.data();
  n.is_double = is_double(a, name);
  n.columns = columns;
  const size_t width = static_cast<size_t>(columns);
  n.one = a.size() == width && a.ndim() == (columns == 1 ? 0u : 1u);
  if (!n.one && !(a.ndim() >= 1 && a.shape(0) == rows && a.size() == rows * width)) {
    throw nanobind::type_error((std::string(name) + " has the wrong shape").c_str());
  }
  return n;
}

// A new array that owns its data.
template <class T>
nanobind::object make_array(std::vector<size_t> shape, T*& data) {
  size_t size = 1;
  for (size_t n : shape) size *= n;
  auto owned = std::make_unique<Array<T>>(size == 0 ? 1 : size);
  data = owned->data();
  nanobind::capsule owner(owned.release(),
                          [](void* p) noexcept { delete static_cast<Array<T>*>(p); });
  return nanobind::cast(
      nanobind::ndarray<nanobind::numpy, T>(data, shape.size(), shape.data(), owner));
}

// The numbers of a vector, which it is left without, as rows of `width`; 0 is a single row of all.
template <class T>
nanobind::object adopt(std::vector<T>&& values, size_t width = 0) {
  auto owned = std::make_unique<std::vector<T>>(std::move(values));
  owned->reserve(1);  // an array needs an address
  T* data = owned->data();
  const size_t shape[2] = {width ? owned->size() / width : owned->size(), width};
  nanobind::capsule owner(owned.release(),
                          [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nanobind::cast(nanobind::ndarray<nanobind::numpy, T>(data, width ? 2 : 1, shape, owner));
}

}  // namespace parhelion
