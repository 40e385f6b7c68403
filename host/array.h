// Arrays as large as the scene.
#pragma once
#include <cstddef>
#include <new>
#include <type_traits>
#include <utility>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace parhelion {

// Values that are written before they are read: nothing is written beforehand, so memory is taken
// when it is used and by the thread that uses it. Begins on a line of the cache. Large ones ask for
// large pages: rays go all over them, and each small page is looked up by itself.
template <class T>
class Array {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  Array() = default;
  explicit Array(size_t size) : size_(size) {
    if (size == 0) return;
    data_ = static_cast<T*>(::operator new(bytes(), alignment()));
#if defined(__linux__)
    if (bytes() >= kLarge) madvise(data_, bytes(), MADV_HUGEPAGE);  // a wish: refused, all works
#endif
  }
  Array(Array&& other) noexcept { *this = std::move(other); }
  Array& operator=(Array&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~Array() {
    if (data_) ::operator delete(data_, alignment());
  }

  T* data() { return data_; }
  const T* data() const { return data_; }
  T* begin() { return data_; }
  T* end() { return data_ + size_; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }
  T& operator[](size_t i) { return data_[i]; }
  const T& operator[](size_t i) const { return data_[i]; }
  size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  size_t bytes() const { return size_ * sizeof(T); }

 private:
  static constexpr size_t kPage = size_t{1} << 21;  // a large one, of x86 and of most ARM systems
  static constexpr size_t kLarge = 2 * kPage;

  std::align_val_t alignment() const { return std::align_val_t{bytes() >= kLarge ? kPage : 64}; }

  T* data_ = nullptr;
  size_t size_ = 0;
};

}  // namespace parhelion
