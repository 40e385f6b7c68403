#include "image.h"

#include <omp.h>

#include <algorithm>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

#include "errors.h"
#include "threads.h"

namespace parhelion {
namespace {

using namespace baseline;

// A number of IEEE 754 binary16.
struct Half {
  unsigned short bits;
};

float half_to_float(Half h) {
  const u32 sign = (h.bits & 0x8000u) << 16, exponent = (h.bits >> 10) & 31u;
  const u32 fraction = h.bits & 0x3ffu;
  if (exponent == 0) {  // 0 and the numbers below 2^-14, in steps of 2^-24
    const float size = static_cast<float>(fraction) * 0x1p-24f;
    return sign != 0 ? -size : size;
  }
  const u32 own = exponent == 31 ? 255u : exponent + 112u;
  return __builtin_bit_cast(float, sign | own << 23 | fraction << 13);
}

float to_float(unsigned short x) { return static_cast<float>(x) / 65535.0f; }
float to_float(Half x) { return half_to_float(x); }
float to_float(float x) { return x; }

float srgb_to_linear(float x) {
  return x <= 0.04045f ? x / 12.92f : pow((x + 0.055f) / 1.055f, 2.4f);
}

float linear_to_srgb(float x) {
  return x <= 0.0031308f ? x * 12.92f : 1.055f * pow(x, 1.0f / 2.4f) - 0.055f;
}

u8 to_byte(float x) { return static_cast<u8>(clamp(x, 0.0f, 1.0f) * 255.0f + 0.5f); }

// The codes of sRGB by search instead of by a power.
class SrgbCodes {
 public:
  SrgbCodes() {
    for (u32 code = 1; code < 256; ++code) {
      u32 low = 0, high = __builtin_bit_cast(u32, 1.0f);  // bits of numbers below it and not
      while (high - low > 1) {
        const u32 middle = low + (high - low) / 2;
        const bool below = to_byte(linear_to_srgb(__builtin_bit_cast(float, middle))) < code;
        (below ? low : high) = middle;
      }
      first_[code] = __builtin_bit_cast(float, high);
    }
    first_[256] = kInfinity;
    for (u32 i = 0, code = 0; i < kBins; ++i) {
      const float x = static_cast<float>(i) / static_cast<float>(kBins);
      while (first_[code + 1] <= x) ++code;
      guide_[i] = static_cast<u8>(code);
    }
  }

  u8 of(float x) const {
    const float inside = clamp(x, 0.0f, 1.0f);
    const u32 code = guide_[std::min(static_cast<u32>(inside * kBins), kBins - 1)];
    return static_cast<u8>(code + (first_[code + 1] <= inside));
  }

 private:
  // So many that none has two codes begin in it: next to black they are 1 / (12.92 * 255) apart.
  static constexpr u32 kBins = 4096;
  float first_[257] = {};  // the least number of each code; of that after the last one, infinity
  u8 guide_[kBins] = {};   // the code of the least number in each bin of [0, 1)
};

// Which texels of a row or column of n make texel i of the next level, and in what shares: two of
// an even number; of an odd one three, the outer ones in part.
struct Taps {
  u32 first;
  u32 count;
  float share[3];
};

Taps taps(u32 i, u32 n) {
  if (n == 1) return {0, 1, {1.0f, 0.0f, 0.0f}};
  if (n % 2 == 0) return {2 * i, 2, {0.5f, 0.5f, 0.0f}};
  const float whole = static_cast<float>(n), half = static_cast<float>(n / 2);
  const float at = static_cast<float>(i);
  return {2 * i, 3, {(half - at) / whole, half / whole, (at + 1.0f) / whole}};
}

// Adds a share of a row of n texels to a row of the next level.
template <u32 kChannels, u32 kTaps>
void add_row(const float* row, u32 n, float share, float* sums) {
  for (u32 x = 0, w = std::max(n / 2, 1u); x < w; ++x) {
    const Taps columns = taps(x, n);
    const float* from = row + size_t{columns.first} * kChannels;
    for (u32 k = 0; k < kChannels; ++k) {
      float sum = sums[x * kChannels + k];
      for (u32 i = 0; i < kTaps; ++i) sum += share * columns.share[i] * from[i * kChannels + k];
      sums[x * kChannels + k] = sum;
    }
  }
}

template <u32 kChannels>
void add_row(const float* row, u32 n, float share, float* sums) {
  switch (n == 1 ? 1 : 2 + n % 2) {
    case 1: return add_row<kChannels, 1>(row, n, share, sums);
    case 2: return add_row<kChannels, 2>(row, n, share, sums);
    default: return add_row<kChannels, 3>(row, n, share, sums);
  }
}

void add_row(u32 channels, const float* row, u32 n, float share, float* sums) {
  switch (channels) {
    case 1: return add_row<1>(row, n, share, sums);
    case 3: return add_row<3>(row, n, share, sums);
    default: return add_row<4>(row, n, share, sums);
  }
}

// The least and the greatest of the colours among `size` numbers, without alpha.
template <class T>
std::pair<T, T> color_range(const T* data, size_t size, u32 channels) {
  constexpr size_t kLanes = 64;  // a multiple of 4, so that alpha has lanes of its own
  T least[kLanes], most[kLanes];
  std::fill(least, least + kLanes, data[0]);
  std::fill(most, most + kLanes, data[0]);
  const size_t groups = size / kLanes;
#pragma omp parallel for schedule(static) reduction(min : least[ : kLanes]) \
    reduction(max : most[ : kLanes]) if (size > kFewElements)
  for (size_t group = 0; group < groups; ++group) {
    for (size_t j = 0; j < kLanes; ++j) {
      const T x = data[group * kLanes + j];
      least[j] = std::min(least[j], x), most[j] = std::max(most[j], x);
    }
  }
  for (size_t i = groups * kLanes; i < size; ++i) {
    const size_t j = i % kLanes;
    least[j] = std::min(least[j], data[i]), most[j] = std::max(most[j], data[i]);
  }
  for (size_t j = 0; j < kLanes; ++j) {
    if (channels == 4 && j % 4 == 3) continue;
    least[0] = std::min(least[0], least[j]), most[0] = std::max(most[0], most[j]);
  }
  return {least[0], most[0]};
}

bool all_finite(const float* data, size_t size) {
  u32 bad = 0;
#pragma omp parallel for schedule(static) reduction(| : bad) if (size > kFewElements)
  for (size_t i = 0; i < size; ++i) bad |= finite(data[i]) ? 0u : 1u;
  return bad == 0;
}

}  // namespace

ImagePyramid::ImagePyramid(const ImageInput& input) {
  const std::string who = "image '" + input.name + "': ";
  if (input.width == 0 || input.height == 0) throw SceneError(who + "has no pixels");
  if (input.width > kMaxImageSide || input.height > kMaxImageSide) {
    throw SceneError(who + "is " + std::to_string(input.width) + " x " +
                     std::to_string(input.height) + " pixels; at most " +
                     std::to_string(kMaxImageSide) + " are allowed on a side");
  }
  if (input.channels < 1 || input.channels > 4) {
    throw SceneError(who + "has " + std::to_string(input.channels) + " channels; 1 to 4 are known");
  }
  view_.width = input.width;
  view_.height = input.height;
  view_.channels = input.channels == 2 ? 4 : input.channels;
  u64 total = 0;
  for (u32 w = input.width, h = input.height;; w = std::max(w / 2, 1u), h = std::max(h / 2, 1u)) {
    view_.first[view_.levels++] = static_cast<u32>(total);
    total += u64{w} * h;
    if (!input.mip || (w == 1 && h == 1)) break;
  }
  if (total > std::numeric_limits<u32>::max()) {
    throw SceneError(who + "has " + std::to_string(u64{input.width} * input.height) +
                     " pixels, more than can be kept");
  }
  if (input.type == SampleType::uint8) {
    view_.format = input.srgb ? ImageFormat::srgb8 : ImageFormat::linear8;
    bytes_ = Array<u8>(total * view_.channels);
    view_.texels = bytes_.data();
  } else {
    view_.format = ImageFormat::float32;
    floats_ = Array<float>(total * view_.channels);
    view_.texels = floats_.data();
  }
  switch (input.type) {
    case SampleType::uint8: read_bytes(input); break;
    case SampleType::uint16: read(input, static_cast<const unsigned short*>(input.data)); break;
    case SampleType::float16: read(input, static_cast<const Half*>(input.data)); break;
    case SampleType::float32: read(input, static_cast<const float*>(input.data)); break;
  }
  check(input);
  if (input.mip) reduce();
}

ImagePyramid::Needs ImagePyramid::needs(const ImageInput& input) {
  const u64 channels = input.channels == 2 ? 4 : input.channels;
  u64 texels = u64{input.width} * input.height, level[kMaxImageLevels] = {};
  if (input.mip) {
    for (u32 w = input.width, h = input.height, l = 1; w > 1 || h > 1; ++l) {
      w = std::max(w / 2, 1u), h = std::max(h / 2, 1u);
      level[l] = u64{w} * h;
      texels += level[l];
    }
  }
  if (input.type != SampleType::uint8) return {texels * channels * sizeof(float), 0};
  // The second level in float, and the third beside it.
  return {texels * channels, (level[1] + level[2]) * channels * sizeof(float)};
}

ImageView ImagePyramid::view() const {
  ImageView v = view_;
  v.texels = bytes_.empty() ? static_cast<const void*>(floats_.data()) : bytes_.data();
  return v;
}

void ImagePyramid::read_bytes(const ImageInput& input) {
  const u8* data = static_cast<const u8*>(input.data);
  const size_t in = size_t{input.width} * input.channels;
  const size_t out = size_t{input.width} * view_.channels;
#pragma omp parallel for schedule(static) if (out * input.height > kFewElements)
  for (u32 y = 0; y < input.height; ++y) {
    const u8* from = data + y * in;
    u8* to = bytes_.data() + y * out;
    if (in == out) {
      std::copy(from, from + in, to);
      continue;
    }
    for (size_t x = 0; x < input.width; ++x) {  // grey and alpha
      std::fill(to + 4 * x, to + 4 * x + 3, from[2 * x]);
      to[4 * x + 3] = from[2 * x + 1];
    }
  }
}

template <class Sample>
void ImagePyramid::read(const ImageInput& input, const Sample* data) {
  const size_t texels = size_t{input.width} * input.height;
  const u32 in = input.channels, out = view_.channels;
  const auto color = [&](Sample x) {
    return input.srgb ? srgb_to_linear(to_float(x)) : to_float(x);
  };
  // Of two bytes there are so few samples that in a larger image each is worked out once.
  std::vector<float> known;
  if constexpr (sizeof(Sample) == 2) {
    if (input.srgb && texels > 1u << 16) {
      known.resize(1u << 16);
      for_all(known.size(), [&](size_t bits) {
        known[bits] = color(__builtin_bit_cast(Sample, static_cast<unsigned short>(bits)));
      });
    }
  }
  const auto color_of = [&](Sample x) {
    if constexpr (sizeof(Sample) == 2) {
      if (!known.empty()) return known[__builtin_bit_cast(unsigned short, x)];
    }
    return color(x);
  };
  for_all(texels, [&](size_t i) {
    const Sample* from = data + i * in;
    float* to = floats_.data() + i * out;
    // of grey and alpha, the first three are grey
    for (u32 c = 0; c < std::min(out, 3u); ++c) to[c] = color_of(from[in == 2 ? 0 : c]);
    if (out == 4) to[3] = to_float(from[in - 1]);
  });
}

// Finds what is not finite, and the range of the colours.
void ImagePyramid::check(const ImageInput& input) {
  const size_t size = size_t{input.width} * input.height * view_.channels;
  if (floats_.empty()) {
    const float* value = input.srgb ? kBytes.srgb : kBytes.plain;
    const auto [least, most] = color_range<u8>(bytes_.data(), size, view_.channels);
    low_ = value[least], high_ = value[most];
    return;
  }
  if (!all_finite(floats_.data(), size)) {
    const float* bad =
        std::find_if(floats_.begin(), floats_.begin() + size, [](float x) { return !finite(x); });
    const size_t texel = static_cast<size_t>(bad - floats_.begin()) / view_.channels;
    throw SceneError("image '" + input.name + "': the pixel in row " +
                     std::to_string(texel / input.width) + ", column " +
                     std::to_string(texel % input.width) + " is not finite");
  }
  std::tie(low_, high_) = color_range<float>(floats_.data(), size, view_.channels);
}

// Every level from the one above it, that one as it was before it was cut to bytes.
void ImagePyramid::reduce() {
  const ImageView image = view();
  const u32 channels = image.channels;
  const bool in_bytes = floats_.empty(), encoded = image.format == ImageFormat::srgb8;
  const auto is_alpha = [channels](size_t i) { return channels == 4 && i % 4 == 3; };
  static const SrgbCodes codes;
  Array<float> kept, level;  // of bytes, the level above and this one
  for (u32 l = 1; l < image.levels; ++l) {
    const u32 from_w = level_side(image.width, l - 1), from_h = level_side(image.height, l - 1);
    const u32 w = level_side(image.width, l), h = level_side(image.height, l);
    const size_t from_size = size_t{from_w} * channels, size = size_t{w} * channels;
    const size_t from_first = size_t{image.first[l - 1]} * channels;
    const size_t first = size_t{image.first[l]} * channels;
    if (in_bytes) {
      level = Array<float>();  // before there is another one
      level = Array<float>(size * h);
    }
    // A row of the image's bytes as numbers, for each thread.
    const size_t threads = in_bytes && l == 1 ? static_cast<size_t>(omp_get_max_threads()) : 0;
    std::vector<float> lines(threads * from_size);
#pragma omp parallel for schedule(static) if (i64{w} * h > i64{kFewElements})
    for (u32 y = 0; y < h; ++y) {
      float* sums = in_bytes ? &level[y * size] : &floats_[first + y * size];
      std::fill(sums, sums + size, 0.0f);
      const Taps rows = taps(y, from_h);
      for (u32 j = 0; j < rows.count; ++j) {
        const size_t at = (rows.first + j) * from_size;
        const float* row;
        if (!in_bytes) {
          row = &floats_[from_first + at];
        } else if (l > 1) {
          row = &kept[at];
        } else {
          float* line = &lines[static_cast<size_t>(omp_get_thread_num()) * from_size];
          for (size_t i = 0; i < from_size; ++i) {
            line[i] = (encoded && !is_alpha(i) ? kBytes.srgb : kBytes.plain)[bytes_[at + i]];
          }
          row = line;
        }
        add_row(channels, row, from_w, rows.share[j], sums);
      }
      if (!in_bytes) continue;
      u8* bytes = &bytes_[first + y * size];
      for (size_t i = 0; i < size; ++i) {
        bytes[i] = encoded && !is_alpha(i) ? codes.of(sums[i]) : to_byte(sums[i]);
      }
    }
    std::swap(kept, level);
  }
}

}  // namespace parhelion
