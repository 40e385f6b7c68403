// How far the pixels of a film are from what infinitely many samples would show.
//
// A pixel's n samples fall into parts of consecutive ones: with p the largest power of two up to n,
// [0, p/2), [p/2, p) and [p, n). If the parts are independent, sum of b (m - M)^2 over J parts of b
// samples and mean m, over n (J - 1), is an unbiased estimate of the variance of the pixel's mean
// M: exactly so with independent samples. Owen-scrambled Sobol' points fill the gaps that those
// before them left, so that their parts differ from each other more than the whole does from the
// truth: with them the estimate errs on the safe side, most of all where the picture is smooth.
#include <omp.h>

#include <algorithm>
#include <bit>
#include <limits>

#include "render.h"

namespace parhelion {

namespace {

// Added to each pixel's brightness, a share of the picture's mean: the last per cent of black,
// which nobody sees, would take almost all of the time.
constexpr double kDark = 0.01;

// The brightness of a pixel and the variance of its mean: both means over the three channels.
struct Estimate {
  double brightness, variance;
};

Estimate estimate(const FilmPixel& pixel, const Prefix& prefix) {
  const u32 n = pixel.count, p = std::bit_floor(n), rest = n - p;
  Estimate of{0.0, 0.0};
  for (u32 k = 0; k < 3; ++k) {
    const double mean = baseline::mean(pixel.rgb[k], n), half = prefix.half[k],
                 whole = prefix.whole[k];
    const double first = half - mean, second = 2.0 * whole - half - mean;
    double sum = 0.5 * p * (first * first + second * second);
    if (rest != 0) {
      const double third = (n * mean - p * whole) / rest - mean;
      sum = 0.5 * (sum + rest * third * third);
    }
    of.brightness += mean / 3.0;
    of.variance += sum / n / 3.0;
  }
  return of;
}

}  // namespace

void Film::errors(double* mean_squares) const {
  const u32 across = cells_across(), down = cells_down();
  double sum = 0.0;
  for (const FilmPixel& p : pixels) {
    for (const FilmSum& rgb : p.rgb) sum += baseline::mean(rgb, p.count) / 3.0;
  }
  const double floor = kDark * sum / static_cast<double>(pixels.size());
#pragma omp parallel for schedule(static)
  for (i64 cell = 0; cell < i64{across} * down; ++cell) {
    const u32 x0 = static_cast<u32>(cell % across) * kBlock, row = static_cast<u32>(cell / across);
    const u32 y0 = row / 2 * kBlock;
    const u32 x1 = std::min(x0 + kBlock, width), y1 = std::min(y0 + kBlock, height);
    double total = 0.0;
    u32 count = 0;
    for (u32 py = std::min(y0 + row % 2, y1 - 1); py < y1; py += 2) {
      for (u32 px = x0; px < x1; ++px, ++count) {
        const size_t at = static_cast<size_t>(py) * width + px;
        if (pixels[at].count < 2) {
          total = std::numeric_limits<double>::infinity();
          continue;
        }
        const Estimate e = estimate(pixels[at], prefixes[at]);
        const double scale = std::max(e.brightness, 0.0) + floor;
        if (e.variance > 0.0) total += e.variance / (scale * scale);
      }
    }
    mean_squares[cell] = total / count;
  }
}

void Film::variances(float* of_pixels) const {
  const i64 count = static_cast<i64>(pixels.size());
#pragma omp parallel for schedule(static)
  for (i64 i = 0; i < count; ++i) {
    of_pixels[i] = pixels[i].count < 2
                       ? std::numeric_limits<float>::infinity()
                       : static_cast<float>(estimate(pixels[i], prefixes[i]).variance);
  }
}

}  // namespace parhelion
