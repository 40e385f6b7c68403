// The elementary functions of core/special.h against the standard library's in double.
#include <algorithm>
#include <cmath>
#include <limits>

#include "../../core/special.h"
#include "check.h"

namespace {

using namespace parhelion;
namespace ph = parhelion::baseline;

constexpr int kSteps = 200000;
constexpr double kPiD = 3.14159265358979324;

// The greatest relative error over equal steps from low to high.
template <class Ours, class Exact>
double worst(double low, double high, Ours ours, Exact exact) {
  double most = 0.0;
  for (int i = 0; i <= kSteps; ++i) {
    const float x = static_cast<float>(low + (high - low) * i / kSteps);
    const double wanted = exact(static_cast<double>(x)), got = static_cast<double>(ours(x));
    if (wanted == 0.0) {
      if (got != 0.0) return std::numeric_limits<double>::infinity();
      continue;
    }
    const double error = std::abs(got / wanted - 1.0);
    if (!(error <= most)) most = error;  // NaN counts as well
  }
  return most;
}

double erf_inverse_exact(double y) {
  double x = static_cast<double>(ph::erf_inverse_within(static_cast<float>(y)));
  for (int i = 0; i < 3; ++i) {
    // by erfc near 1, where erf has no digits left
    const double off = y > 0.5 ? (1.0 - y) - std::erfc(x) : std::erf(x) - y;
    x -= off * 0.5 * std::sqrt(kPiD) * std::exp(x * x);
  }
  return x;
}

void accuracy() {
  CHECK(worst(
            -87.0, 88.7, [](float x) { return ph::exp(x); }, [](double x) { return std::exp(x); }) <
        2e-7);
  CHECK(worst(
            -1.0, 1.0, [](float x) { return ph::exp(x); }, [](double x) { return std::exp(x); }) <
        2e-7);
  const auto log = [](float x) { return ph::log(x); };
  const auto log_exact = [](double x) { return std::log(x); };
  CHECK(worst(1e-6, 4.0, log, log_exact) < 2e-7);
  CHECK(worst(0.999, 1.001, log, log_exact) < 2e-7);
  CHECK(worst(1e30, 3e38, log, log_exact) < 2e-7);
  CHECK(worst(1e-40, 1e-36, log, log_exact) < 2e-7);
  CHECK(worst(
            1e-3, 8.0, [](float x) { return ph::log2(x); }, [](double x) { return std::log2(x); }) <
        3e-7);
  for (float y : {-3.7f, -0.5f, 0.1f, 1.0f / 2.4f, 2.4f, 20.0f}) {
    const double exponent = static_cast<double>(y);
    CHECK(worst(
              0.05, 5.0, [&](float x) { return ph::pow(x, y); },
              [&](double x) { return std::pow(x, exponent); }) < 1e-7);
  }
  for (float x : {-2.0f, -1e-4f, 0.3f, 7.0f}) {
    const double across = static_cast<double>(x);
    CHECK(worst(
              -3.0, 3.0, [&](float y) { return ph::atan2(y, x); },
              [&](double y) { return std::atan2(y, across); }) < 3e-7);
  }
  CHECK(worst(
            -1.0, 1.0, [](float x) { return ph::asin(x); }, [](double x) { return std::asin(x); }) <
        4e-7);
  CHECK(worst(
            -1.0, 1.0, [](float x) { return ph::acos(x); }, [](double x) { return std::acos(x); }) <
        4e-7);
  const auto erf = [](float x) { return ph::erf_within(x); };
  const auto erf_exact = [](double x) { return std::erf(x); };
  CHECK(worst(0.5, 4.0, erf, erf_exact) < 3e-7);
  for (int i = 0; i <= kSteps; ++i) {
    const float x = 4.0f * static_cast<float>(i) / kSteps;
    CHECK(std::abs(static_cast<double>(erf(x)) - erf_exact(static_cast<double>(x))) < 2e-7);
  }
  const auto erf_inverse = [](float y) { return ph::erf_inverse_within(y); };
  CHECK(worst(-0.5, 0.99999, erf_inverse, erf_inverse_exact) < 6e-7);
  CHECK(worst(0.9999, 1.0 - 0x1p-24, erf_inverse, erf_inverse_exact) < 6e-7);
}

// Ends of the ranges, and what is not a number.
void ends() {
  const float inf = kInfinity, nan = ph::kNan;
  const auto is_nan = [](float x) { return x != x; };
  CHECK(ph::exp(0.0f) == 1.0f && ph::exp(-inf) == 0.0f && ph::exp(inf) == inf);
  CHECK(ph::exp(89.0f) == inf && ph::exp(-105.0f) == 0.0f && ph::exp(-103.0f) == 0x1p-149f);
  CHECK(ph::log(1.0f) == 0.0f && ph::log(0.0f) == -inf && ph::log(inf) == inf);
  CHECK(ph::log2(8.0f) == 3.0f && ph::log2(0x1p-149f) == -149.0f);
  CHECK(ph::pow(0.0f, 2.0f) == 0.0f && ph::pow(0.0f, -1.0f) == inf && ph::pow(0.0f, 0.0f) == 1.0f);
  CHECK(ph::pow(inf, 2.0f) == inf && ph::pow(inf, -2.0f) == 0.0f &&
        ph::pow(2.0f, 10.0f) == 1024.0f);
  CHECK(ph::pow(2.0f, 200.0f) == inf && ph::pow(2.0f, -200.0f) == 0.0f);
  CHECK(ph::atan2(0.0f, 1.0f) == 0.0f && ph::atan2(0.0f, -1.0f) == kPi &&
        ph::atan2(0.0f, 0.0f) == 0.0f);
  CHECK(ph::atan2(1.0f, 0.0f) == 0.5f * kPi && ph::atan2(inf, inf) == ph::atan2(1.0f, 1.0f));
  CHECK(ph::asin(1.1f) == 0.5f * kPi && ph::acos(1.1f) == 0.0f && ph::acos(-1.1f) == kPi);
  CHECK(ph::erf_inverse_within(0.0f) == 0.0f);
  CHECK(ph::floor(-0.5f) == -1.0f && ph::floor(2.0f) == 2.0f && ph::floor(-1e30f) == -1e30f);
  CHECK(is_nan(ph::exp(nan)) && is_nan(ph::log(nan)) && is_nan(ph::log2(nan)));
  CHECK(is_nan(ph::log(-1.0f)) && is_nan(ph::pow(-1.0f, 2.0f)) && is_nan(ph::pow(2.0f, nan)));
  CHECK(is_nan(ph::atan2(nan, 1.0f)) && is_nan(ph::asin(nan)) && is_nan(ph::acos(nan)));
}

}  // namespace

int main() {
  accuracy();
  ends();
  std::printf(failures == 0 ? "special functions: ok\n" : "special functions: %d failures\n",
              failures);
  return failures != 0;
}
