// NumPy arrays of what C++ has made.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <memory>
#include <utility>
#include <vector>

#include "../core/types.h"
#include "../host/array.h"

namespace parhelion {

using FloatRows = nanobind::ndarray<const float, nanobind::shape<-1, 3>, nanobind::c_contig,
                                    nanobind::device::cpu>;
using Floats =
    nanobind::ndarray<const float, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;

inline const Vec3* vectors(const FloatRows& a) { return reinterpret_cast<const Vec3*>(a.data()); }

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
