#include "distribution.h"

#include <cmath>
#include <cstddef>

#include "../core/panorama.h"

namespace parhelion {
namespace {

double usable(double weight) { return weight > 0.0 && std::isfinite(weight) ? weight : 0.0; }

// Where each of n shares of the whole begins. One unit is set aside for every positive weight, so
// that none is lost beside a much larger one. Returns the sum of the weights.
double set_starts(const double* weights, size_t n, u32* starts) {
  double sum = 0.0;
  size_t positive = 0;
  for (size_t i = 0; i < n; ++i) {
    const double w = usable(weights[i]);
    sum += w;
    positive += w > 0.0;
  }
  const double scale =
      sum > 0.0 ? static_cast<double>(kDistributionWhole - static_cast<u32>(positive)) / sum : 0.0;
  double before = 0.0;
  u32 reserved = 0;
  for (size_t i = 0; i < n; ++i) {
    starts[i] = static_cast<u32>(before * scale) + reserved;
    const double w = usable(weights[i]);
    before += w;
    reserved += w > 0.0;
  }
  return sum;
}

// For n shares, in which of them each of n equal parts of the whole begins.
void set_guide(const u32* starts, size_t n, u16* guide) {
  size_t share = 0;
  for (size_t part = 0; part < n; ++part) {
    const u64 begin = ((static_cast<u64>(part) << 32) + n - 1) / n;  // as the search rounds
    while (share + 1 < n && starts[share + 1] <= begin) ++share;
    guide[part] = static_cast<u16>(share);
  }
}

// Takes half of the mean radiance off each cell's weight, its radiance times its solid angle: light
// that comes from everywhere is found by scattering as well, with which light samples share by the
// balance of their densities, and each need only give what the other does not. Without bias, as
// scattering goes wherever a surface reflects to. Method: O. Karlik, M. Sik, P. Vevoda, T. Skrivan
// and J. Krivanek, "MIS Compensation: Optimizing Sampling Techniques in Multiple Importance
// Sampling", ACM TOG 38(6), 2019, for a surface of which nothing is known.
template <class SolidAngle>
void leave_to_scattering(std::vector<double>& weights, u32 width, u32 height,
                         const SolidAngle& of_row) {
  double light = 0.0, sphere = 0.0;
  for (u32 y = 0; y < height; ++y) {
    for (u32 x = 0; x < width; ++x) light += usable(weights[static_cast<size_t>(y) * width + x]);
    sphere += width * of_row(y);
  }
  for (u32 y = 0; y < height; ++y) {
    const double half_mean = 0.5 * light / sphere * of_row(y);
    for (u32 x = 0; x < width; ++x) {
      double& w = weights[static_cast<size_t>(y) * width + x];
      w = usable(w - half_mean);
    }
  }
}

}  // namespace

DistributionTable::DistributionTable(u32 width, u32 height, const std::vector<double>& weights)
    : width_(width),
      height_(height),
      rows_(height),
      columns_(weights.size()),
      row_guide_(height),
      column_guide_(weights.size()) {
  std::vector<double> row(height);
  const double* const w = weights.data();
#pragma omp parallel for schedule(static)
  for (size_t y = 0; y < height; ++y) {
    row[y] = set_starts(w + y * width, width, columns_.data() + y * width);
  }
  if (!(set_starts(row.data(), height, rows_.data()) > 0.0)) {
    const std::vector<double> same(width > height ? width : height, 1.0);
    for (size_t y = 0; y < height; ++y) set_starts(same.data(), width, columns_.data() + y * width);
    set_starts(same.data(), height, rows_.data());
  }
  set_guide(rows_.data(), height, row_guide_.data());
#pragma omp parallel for schedule(static)
  for (size_t y = 0; y < height; ++y) {
    set_guide(columns_.data() + y * width, width, column_guide_.data() + y * width);
  }
}

DistributionTable latlong_distribution(const ImageView& image) {
  const u32 rows = baseline::latlong_rows(image);
  std::vector<double> weights(static_cast<size_t>(image.width) * rows);
  const auto solid_angle = [&](u32 y) {
    return baseline::cos_pi(static_cast<double>(y) / rows) -
           baseline::cos_pi(static_cast<double>(y + 1) / rows);
  };
#pragma omp parallel for schedule(static)
  for (u32 y = 0; y < rows; ++y) {
    const double cell = solid_angle(y);
    for (u32 x = 0; x < image.width; ++x) {
      weights[static_cast<size_t>(y) * image.width + x] =
          cell * baseline::latlong_weight(baseline::latlong_cell(image, x, y, {0, 0}));
    }
  }
  leave_to_scattering(weights, image.width, rows, solid_angle);
  return DistributionTable(image.width, rows, weights);
}

DistributionTable equal_area_distribution(const ImageView& image) {
  std::vector<double> weights(static_cast<size_t>(image.width) * image.height);
#pragma omp parallel for schedule(static)
  for (u32 y = 0; y < image.height; ++y) {
    for (u32 x = 0; x < image.width; ++x) {
      weights[static_cast<size_t>(y) * image.width + x] =
          baseline::luminance(baseline::fetch(image, 0, x, y).rgb);
    }
  }
  leave_to_scattering(weights, image.width, image.height, [](u32) { return 1.0; });
  return DistributionTable(image.width, image.height, weights);
}

}  // namespace parhelion
