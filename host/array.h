// Arrays as large as the scene, or the picture.
#pragma once
#include <cstddef>
#include <cstdint>
#include <new>
#include <type_traits>
#include <utility>

#if defined(__linux__)
#include <sys/mman.h>
#include <unistd.h>
#endif

namespace parhelion {

// Values that are written before they are read: but by zeros() nothing is written beforehand, so
// memory is taken when it is used and by the thread that uses it. Begins on a line of the cache.
// Large ones come from the system and go back to it, so that what is held at a time is what was
// counted; and they ask for large pages: rays go all over them, and each small page is looked up by
// itself.
template <class T>
class Array {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  Array() = default;
  explicit Array(size_t size) : size_(size) {
    if (size == 0) return;
#if defined(__linux__)
    if (is_large()) {
      data_ = static_cast<T*>(from_system());
      return;
    }
#endif
    data_ = static_cast<T*>(::operator new(bytes(), kLine));
  }
  // Of zeros, or whatever T begins with. Of a large one each thread takes a part of the memory.
  static Array zeros(size_t size) {
    Array a(size);
#pragma omp parallel for schedule(static) if (a.is_large())
    for (size_t i = 0; i < size; ++i) a.data_[i] = T{};
    return a;
  }
  Array(Array&& other) noexcept { *this = std::move(other); }
  Array& operator=(Array&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~Array() {
    if (!data_) return;
#if defined(__linux__)
    if (is_large()) {
      munmap(data_, bytes());
      return;
    }
#endif
    ::operator delete(data_, kLine);
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
  static constexpr std::align_val_t kLine{64};
  static constexpr size_t kPage = size_t{1} << 21;  // a large one, of x86 and of most ARM systems
  static constexpr size_t kLarge = 2 * kPage;

  bool is_large() const { return bytes() >= kLarge; }

#if defined(__linux__)
  // From the beginning of a large page on: so much more is asked for, and given back on both sides.
  void* from_system() const {
    const size_t small = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    const size_t size = (bytes() + small - 1) & ~(small - 1);
    constexpr int kAccess = PROT_READ | PROT_WRITE, kWays = MAP_PRIVATE | MAP_ANONYMOUS;
    void* const all = mmap(nullptr, size + kPage, kAccess, kWays, -1, 0);
    if (all == MAP_FAILED) throw std::bad_alloc();
    const size_t before = -reinterpret_cast<std::uintptr_t>(all) & (kPage - 1);
    char* const begin = static_cast<char*>(all) + before;
    if (before != 0) munmap(all, before);
    munmap(begin + size, kPage - before);
    madvise(begin, size, MADV_HUGEPAGE);  // a wish: refused, all works
    return begin;
  }
#endif

  T* data_ = nullptr;
  size_t size_ = 0;
};

}  // namespace parhelion
