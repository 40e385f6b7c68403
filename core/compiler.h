// What compilers spell differently: GCC and Clang on one side, NVRTC on the other.
#pragma once

#if defined(__CUDACC__)

#define PH_INLINE __forceinline__
#define PH_APART
#define PH_TABLE __device__ const  // an array of constants
#define PH_UNROLL _Pragma("unroll")

namespace parhelion::compiler {
PH_INLINE float sqrt(float x) { return ::sqrtf(x); }
PH_INLINE double sqrt(double x) { return ::sqrt(x); }
PH_INLINE float abs(float x) { return ::fabsf(x); }
PH_INLINE float copysign(float size, float sign) { return ::copysignf(size, sign); }
PH_INLINE unsigned reverse_bytes(unsigned x) { return __byte_perm(x, 0, 0x0123); }
PH_INLINE unsigned trailing_zeros(unsigned x) { return static_cast<unsigned>(__ffs(x) - 1); }
PH_INLINE unsigned leading_zeros(unsigned x) { return static_cast<unsigned>(__clz(x)); }
PH_INLINE unsigned ones(unsigned x) { return static_cast<unsigned>(__popc(x)); }
PH_INLINE void copy(void* to, const void* from, unsigned long long n) { memcpy(to, from, n); }
PH_INLINE void prefetch(const void*) {}  // other threads work meanwhile
PH_INLINE unsigned long long ticks() { return static_cast<unsigned long long>(clock64()); }
[[noreturn]] PH_INLINE void unreachable() { __builtin_unreachable(); }
}  // namespace parhelion::compiler

#else

#ifndef PH_INLINE
#define PH_INLINE [[gnu::always_inline]] inline
#endif
// A function that is compiled by itself: whether its loops become vectors does then not depend on
// where it is called.
#define PH_APART [[gnu::noinline]]
#define PH_TABLE inline constexpr  // an array of constants
// Before a short loop over a struct's numbers: unrolled, it leaves the struct in registers.
#define PH_UNROLL _Pragma("GCC unroll 32")

namespace parhelion::compiler {
PH_INLINE float sqrt(float x) { return __builtin_sqrtf(x); }
PH_INLINE double sqrt(double x) { return __builtin_sqrt(x); }
PH_INLINE float abs(float x) { return __builtin_fabsf(x); }
PH_INLINE float copysign(float size, float sign) { return __builtin_copysignf(size, sign); }
PH_INLINE unsigned reverse_bytes(unsigned x) { return __builtin_bswap32(x); }
PH_INLINE unsigned trailing_zeros(unsigned x) { return static_cast<unsigned>(__builtin_ctz(x)); }
PH_INLINE unsigned leading_zeros(unsigned x) { return static_cast<unsigned>(__builtin_clz(x)); }
PH_INLINE unsigned ones(unsigned x) { return static_cast<unsigned>(__builtin_popcount(x)); }
PH_INLINE void copy(void* to, const void* from, unsigned long long n) {
  __builtin_memcpy(to, from, n);
}
PH_INLINE void prefetch(const void* p) { __builtin_prefetch(p); }
// A clock that takes some nanoseconds to read, of any unit; always 0 where there is none.
PH_INLINE unsigned long long ticks() {
#if defined(__x86_64__) || defined(__i386__)
  return __builtin_ia32_rdtsc();
#elif defined(__aarch64__)
  unsigned long long now;
  asm volatile("mrs %0, cntvct_el0" : "=r"(now));
  return now;
#else
  return 0;
#endif
}
[[noreturn]] PH_INLINE void unreachable() { __builtin_unreachable(); }
}  // namespace parhelion::compiler

#endif
