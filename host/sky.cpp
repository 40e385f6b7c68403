// Light that the air scatters towards a point on the ground, of one, two and more turns.
//
// The air is a shell around a spherical Earth: molecules, aerosol and ozone, each with a profile of
// height. Single scattering is integrated along the line of sight; what has been scattered more
// often is taken as isotropic, its sum over all orders a geometric series.
// Methods: E. Bruneton and F. Neyret, "Precomputed Atmospheric Scattering", EGSR 2008 (profiles and
// the parametrisation of the table of optical depths); S. Hillaire, "A Scalable and Production
// Ready Sky and Atmosphere Rendering Technique", EGSR 2020, section 5.5 (multiple scattering).
// Everything is computed at twelve wavelengths and then weighted with the sun's spectrum and the
// eye's colour matching functions, so colours do not depend on three wavelengths picked by hand.
#include "sky.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "../core/panorama.h"

namespace parhelion {
namespace {

using baseline::operator+;
using baseline::operator-;
using baseline::operator*;

constexpr double kPiD = 3.14159265358979324;

// Kilometres. Bruneton and Neyret, section 4.
constexpr double kGround = 6360.0, kTop = 6420.0;
constexpr double kMoleculeHeight = 8.0, kAerosolHeight = 1.2;
constexpr double kEye = 0.002;  // above the ground

// Of aerosol: share of the extinction that is scattering, and mean cosine of the angle by which it
// scatters (Bruneton and Neyret, section 4); its optical depth goes with wavelength^-1.3 (Preetham,
// Shirley and Smits, "A Practical Analytic Model for Daylight", SIGGRAPH 1999, appendix A.1).
constexpr double kAerosolAlbedo = 0.9, kAerosolMeanCosine = 0.76;
constexpr float kAngstromExponent = 1.3f;

// Nanometres.
constexpr int kBands = 12;
constexpr double kFirstBand = 390.0, kBandStep = 30.0;
using Spectrum = std::array<double, kBands>;

// Cross-sections of ozone in 1e-24 m^2 at these wavelengths, near 233 K: V. Gorshelev, A.
// Serdyuchenko et al., "High spectral resolution ozone absorption cross-sections", AMT 7, 2014. A
// column of 300 Dobson units of 2.687e20 molecules a m^2, between 10 and 40 km and most at 25.
constexpr Spectrum kOzone = {0.00066, 0.0055, 0.0232, 0.0775, 0.160,  0.309,
                             0.467,   0.502,  0.322,  0.185,  0.0942, 0.051};
constexpr double kOzoneColumn = 300.0 * 2.687e20;

double band(int k) { return kFirstBand + kBandStep * k; }
double exp_of(double x) { return baseline::exp(static_cast<float>(x)); }

// Optical depth of all molecules above the ground. J. Hansen and L. Travis, "Light Scattering in
// Planetary Atmospheres", Space Science Reviews 16, 1974, equation 2.30.
double molecule_depth(double nanometres) {
  const double w = nanometres * 1e-3, w2 = w * w, w4 = w2 * w2;
  return 0.008569 / w4 * (1.0 + 0.0113 / w2 + 0.00013 / w4);
}

// Scattering and extinction in 1 / km at the ground; of ozone, where there is most.
struct Air {
  Spectrum molecule, aerosol, aerosol_extinction, ozone;

  explicit Air(double turbidity) {
    for (int k = 0; k < kBands; ++k) {
      molecule[k] = molecule_depth(band(k)) / kMoleculeHeight;
      // Turbidity is the optical depth of molecules and aerosol over that of molecules alone.
      const float ratio = static_cast<float>(550.0 / band(k));
      aerosol_extinction[k] = (turbidity - 1.0) * molecule_depth(550.0) *
                              baseline::pow(ratio, kAngstromExponent) / kAerosolHeight;
      aerosol[k] = kAerosolAlbedo * aerosol_extinction[k];
      ozone[k] = kOzone[k] * 1e-24 * kOzoneColumn / 15.0;  // a triangle 30 km wide
    }
  }
};

// Densities relative to the above, or their integrals along a line in km.
struct Amount {
  double molecule = 0, aerosol = 0, ozone = 0;

  Amount operator+(const Amount& b) const {
    return {molecule + b.molecule, aerosol + b.aerosol, ozone + b.ozone};
  }
  Amount operator*(double s) const { return {molecule * s, aerosol * s, ozone * s}; }
};

Amount density(double radius) {
  const double h = std::max(radius - kGround, 0.0);
  return {exp_of(-h / kMoleculeHeight), exp_of(-h / kAerosolHeight),
          std::max(0.0, 1.0 - std::abs(h - 25.0) / 15.0)};
}

double depth(const Air& air, const Amount& a, int k) {
  return air.molecule[k] * a.molecule + air.aerosol_extinction[k] * a.aerosol +
         air.ozone[k] * a.ozone;
}

// A ray at a distance `radius` from the Earth's centre, `cosine` from the vertical: how far it is
// to the top of the air, and to the ground, or a negative number if it misses that.
double to_top(double radius, double cosine) {
  const double p = radius * cosine;
  return -p + std::sqrt(std::max(0.0, p * p + (kTop + radius) * (kTop - radius)));
}
double to_ground(double radius, double cosine) {
  const double p = radius * cosine;
  const double q = p * p - (radius + kGround) * (radius - kGround);
  return cosine < 0.0 && q >= 0.0 ? std::max(0.0, -p - std::sqrt(q)) : -1.0;
}
double radius_after(double radius, double cosine, double t) {
  return std::sqrt(t * t + 2.0 * radius * cosine * t + radius * radius);
}

// What lies between a point and the top of the air, by radius and direction.
class DepthTable {
 public:
  DepthTable() {
    amount_.resize(kRadii * kCosines);
#pragma omp parallel for schedule(dynamic, 1)
    for (int i = 0; i < kRadii; ++i) {
      for (int j = 0; j < kCosines; ++j) {
        double radius, cosine;
        place(i, j, radius, cosine);
        amount_[static_cast<size_t>(i) * kCosines + static_cast<size_t>(j)] = sum(radius, cosine);
      }
    }
  }

  // Of a ray that does not meet the ground.
  Amount operator()(double radius, double cosine) const {
    const double rho = std::sqrt(std::max(0.0, radius * radius - kGround * kGround));
    const double nearest = kTop - radius, farthest = rho + kHorizon;
    const double x = rho / kHorizon * (kRadii - 1);
    const double y = (to_top(radius, cosine) - nearest) / (farthest - nearest) * (kCosines - 1);
    const int i = std::clamp(static_cast<int>(x), 0, kRadii - 2);
    const int j = std::clamp(static_cast<int>(y), 0, kCosines - 2);
    const double a = std::clamp(x - i, 0.0, 1.0), b = std::clamp(y - j, 0.0, 1.0);
    const Amount* t = amount_.data() + static_cast<size_t>(i) * kCosines + static_cast<size_t>(j);
    return (t[0] * (1.0 - b) + t[1] * b) * (1.0 - a) +
           (t[kCosines] * (1.0 - b) + t[kCosines + 1] * b) * a;
  }

 private:
  static constexpr int kRadii = 48, kCosines = 128, kSteps = 300;
  // Length of a ray along the horizon from the ground to the top.
  static inline const double kHorizon = std::sqrt(kTop * kTop - kGround * kGround);
  std::vector<Amount> amount_;

  static void place(int i, int j, double& radius, double& cosine) {
    const double rho = kHorizon * i / (kRadii - 1);
    radius = std::sqrt(rho * rho + kGround * kGround);
    const double nearest = kTop - radius, farthest = rho + kHorizon;
    const double d = nearest + (farthest - nearest) * j / (kCosines - 1);
    cosine = d > 0.0 ? (kHorizon * kHorizon - rho * rho - d * d) / (2.0 * radius * d) : 1.0;
    cosine = std::clamp(cosine, -1.0, 1.0);
  }

  static Amount sum(double radius, double cosine) {
    const double length = to_top(radius, cosine), step = length / kSteps;
    Amount a;
    for (int i = 0; i < kSteps; ++i) {
      a = a + density(radius_after(radius, cosine, (i + 0.5) * step)) * step;
    }
    return a;
  }
};

// Per steradian. The aerosol's is Cornette and Shanks', "Physically reasonable analytic expression
// for the single-scattering phase function", Applied Optics 31(16), 1992.
double molecule_phase(double cosine) { return 3.0 / (16.0 * kPiD) * (1.0 + cosine * cosine); }
double aerosol_phase(double cosine) {
  constexpr double g = kAerosolMeanCosine;
  const double b = 1.0 + g * g - 2.0 * g * cosine;
  return 3.0 / (8.0 * kPiD) * (1.0 - g * g) * (1.0 + cosine * cosine) /
         ((2.0 + g * g) * b * std::sqrt(b));
}

// Share of the sun's light that arrives at a point; 0 in the Earth's shadow.
class Transmission {
 public:
  explicit Transmission(const Air& air) : air_(air) {}

  Spectrum operator()(double radius, double sun_cosine) const {
    Spectrum s{};
    if (to_ground(radius, sun_cosine) >= 0.0) return s;
    const Amount a = depths_(radius, sun_cosine);
    for (int k = 0; k < kBands; ++k) s[k] = exp_of(-depth(air_, a, k));
    return s;
  }

 private:
  Air air_;
  DepthTable depths_;
};

// Radiance per irradiance of the sun outside the air, by band.
class Atmosphere {
  Air air_;
  double albedo_;

 public:
  const Transmission from_sun;

  Atmosphere(double turbidity, double albedo, double sun_height)
      : air_(turbidity), albedo_(albedo), from_sun(air_) {
    // From the ground, sky within 1,100 km is seen, over which the sun's height changes by 10
    // degrees.
    constexpr double kCos = 0.98480775, kSin = 0.17364818;
    const double across = std::sqrt(std::max(0.0, 1.0 - sun_height * sun_height));
    low_ = sun_height < -kCos ? -1.0 : sun_height * kCos - across * kSin;
    high_ = sun_height > kCos ? 1.0 : sun_height * kCos + across * kSin;
    fill_multiple();
  }

  // What comes from a direction in the sky, `cosine` from the vertical; the sun is `sun_cosine`
  // from the vertical and `between` from the direction.
  Spectrum sky(double cosine, double sun_cosine, double between) const {
    return march(kGround + kEye, cosine, sun_cosine, between, to_top(kGround + kEye, cosine),
                 kSteps, false)
        .radiance;
  }

 private:
  static constexpr int kSteps = 40;
  static constexpr int kHeights = 16, kSuns = 16;

  double low_ = 0.0, high_ = 0.0;  // sun's cosines that the table spans
  std::vector<Spectrum> multiple_;

  struct Along {
    Spectrum radiance{};   // scattered into the ray
    Spectrum scattered{};  // share of a ray's light that the air on its way scatters
    Spectrum passed{};     // share that reaches the end
  };

  // Along a ray. Within a step the source is constant and the loss exponential, integrated exactly.
  // `isotropic`: molecules and aerosol scatter alike into all directions, and only once.
  Along march(double radius, double cosine, double sun_cosine, double between, double length,
              int steps, bool isotropic) const {
    Along out;
    out.passed.fill(1.0);
    const double phase_m = isotropic ? 1.0 / (4.0 * kPiD) : molecule_phase(between);
    const double phase_a = isotropic ? 1.0 / (4.0 * kPiD) : aerosol_phase(between);
    double start = 0.0;
    for (int i = 0; i < steps; ++i) {
      // Short steps first: near the ground the air is dense.
      const double share = static_cast<double>(i + 1) / steps, end = length * share * share;
      const double step = end - start, t = 0.5 * (start + end);
      start = end;
      const double r = radius_after(radius, cosine, t);
      const double sun = std::clamp((radius * sun_cosine + t * between) / r, -1.0, 1.0);
      const Amount a = density(r);
      const Spectrum direct = from_sun(r, sun);
      const Spectrum indirect = isotropic ? Spectrum{} : multiple(r, sun);
      for (int k = 0; k < kBands; ++k) {
        const double m = air_.molecule[k] * a.molecule, s = air_.aerosol[k] * a.aerosol;
        const double extinction = depth(air_, a, k), loss = exp_of(-extinction * step);
        const double path = extinction > 0.0 ? (1.0 - loss) / extinction : step;
        const double source = direct[k] * (m * phase_m + s * phase_a) + indirect[k] * (m + s);
        out.radiance[k] += out.passed[k] * source * path;
        out.scattered[k] += out.passed[k] * (m + s) * path;
        out.passed[k] *= loss;
      }
    }
    return out;
  }

  // Radiance of second and higher orders, the same in all directions, by height and the sun's
  // cosine.
  void fill_multiple() {
    multiple_.resize(kHeights * kSuns);
#pragma omp parallel for schedule(dynamic, 1)
    for (int i = 0; i < kHeights * kSuns; ++i) {
      const double x = static_cast<double>(i / kSuns) / (kHeights - 1);
      const double radius = kGround + std::max(kEye, (kTop - kGround - 0.01) * x * x);
      const double sun = low_ + (high_ - low_) * (i % kSuns) / (kSuns - 1);
      multiple_[static_cast<size_t>(i)] = orders(radius, sun);
    }
  }

  Spectrum orders(double radius, double sun) const {
    constexpr int kZ = 10, kAzimuths = 8, kMarch = 24;
    Spectrum second{}, again{};
    const double sun_sine = std::sqrt(std::max(0.0, 1.0 - sun * sun));
    for (int i = 0; i < kZ; ++i) {
      const double z = -1.0 + (i + 0.5) * 2.0 / kZ, sine = std::sqrt(1.0 - z * z);
      const double ground = to_ground(radius, z);
      const double length = ground >= 0.0 ? ground : to_top(radius, z);
      for (int j = 0; j < kAzimuths; ++j) {
        const double between =
            z * sun + sine * sun_sine * baseline::cos_pi((j + 0.5) * 2.0 / kAzimuths);
        const Along along = march(radius, z, sun, between, length, kMarch, true);
        Spectrum lit{};
        double ground_sun = 0.0;
        if (ground >= 0.0) {
          ground_sun = std::max(0.0, (radius * sun + ground * between) / kGround);
          if (ground_sun > 0.0) lit = from_sun(kGround, ground_sun);
        }
        for (int k = 0; k < kBands; ++k) {
          second[k] +=
              (along.radiance[k] + along.passed[k] * lit[k] * ground_sun * albedo_ / kPiD) /
              (kZ * kAzimuths);
          again[k] += along.scattered[k] / (kZ * kAzimuths);
        }
      }
    }
    for (int k = 0; k < kBands; ++k) second[k] /= 1.0 - again[k];
    return second;
  }

  Spectrum multiple(double radius, double sun) const {
    const double x =
        std::sqrt(std::max(0.0, (radius - kGround) / (kTop - kGround - 0.01))) * (kHeights - 1);
    const double y = (sun - low_) / (high_ - low_) * (kSuns - 1);
    const int i = std::clamp(static_cast<int>(x), 0, kHeights - 2);
    const int j = std::clamp(static_cast<int>(y), 0, kSuns - 2);
    const double a = std::clamp(x - i, 0.0, 1.0), b = std::clamp(y - j, 0.0, 1.0);
    const Spectrum* t = multiple_.data() + i * kSuns + j;
    Spectrum s;
    for (int k = 0; k < kBands; ++k) {
      s[k] = (t[0][k] * (1.0 - b) + t[1][k] * b) * (1.0 - a) +
             (t[kSuns][k] * (1.0 - b) + t[kSuns + 1][k] * b) * a;
    }
    return s;
  }
};

// Colour matching functions of the CIE's 1931 observer: C. Wyman, P.-P. Sloan and P. Shirley,
// "Simple Analytic Approximations to the CIE XYZ Color Matching Functions", JCGT 2(2), 2013.
double lobe(double x, double center, double below, double above) {
  const double t = (x - center) / (x < center ? below : above);
  return exp_of(-0.5 * t * t);
}
struct Xyz {
  double x, y, z;
};
Xyz matching(double w) {
  return {1.056 * lobe(w, 599.8, 37.9, 31.0) + 0.362 * lobe(w, 442.0, 16.0, 26.7) -
              0.065 * lobe(w, 501.1, 20.4, 26.2),
          0.821 * lobe(w, 568.8, 46.9, 40.5) + 0.286 * lobe(w, 530.9, 16.3, 31.1),
          1.217 * lobe(w, 437.0, 11.8, 36.0) + 0.681 * lobe(w, 459.0, 26.0, 13.8)};
}

// Irradiance of the sun outside the air, W / m^2 / nm: a black body of its effective temperature,
// 5772 K (IAU 2015 resolution B3), that fills 6.794e-5 sr. Within 5 % of the measured spectrum
// above 430 nm.
double sun_irradiance(double nanometres) {
  const double w = nanometres * 1e-9;
  const double radiance =
      1.191042972e-16 / (w * w * w * w * w) / (exp_of(1.438776877e-2 / (w * 5772.0)) - 1.0);
  return radiance * 6.794e-5 * 1e-9;
}

// From radiance per solar irradiance, linear between the bands, to linear Rec. 709 with luminance
// in 1000 cd / m^2.
class Colors {
 public:
  Colors() {
    for (int w = static_cast<int>(band(0)); w < static_cast<int>(band(kBands - 1)); ++w) {
      const double x = (w - kFirstBand) / kBandStep;
      const int k = std::min(static_cast<int>(x), kBands - 2);
      const Xyz c = matching(w);
      const double energy = 0.683 * sun_irradiance(w);
      const double share[2] = {1.0 - (x - k), x - k};
      for (int i = 0; i < 2; ++i) {
        xyz_[k + i].x += share[i] * energy * c.x;
        xyz_[k + i].y += share[i] * energy * c.y;
        xyz_[k + i].z += share[i] * energy * c.z;
      }
    }
  }

  Vec3 rgb(const Spectrum& s) const {
    Xyz c{};
    for (int k = 0; k < kBands; ++k) {
      c.x += s[k] * xyz_[k].x;
      c.y += s[k] * xyz_[k].y;
      c.z += s[k] * xyz_[k].z;
    }
    const auto positive = [](double x) { return static_cast<float>(std::max(x, 0.0)); };
    return {positive(3.2404542 * c.x - 1.5371385 * c.y - 0.4985314 * c.z),
            positive(-0.9692660 * c.x + 1.8760108 * c.y + 0.0415560 * c.z),
            positive(0.0556434 * c.x - 0.2040259 * c.y + 1.0572252 * c.z)};
  }

 private:
  std::array<Xyz, kBands> xyz_{};
};

void set_pixel(std::vector<float>& image, u32 x, u32 y, Vec3 color) {
  float* pixel = &image[(static_cast<size_t>(y) * kSkyWidth + x) * 3];
  pixel[0] = color.x, pixel[1] = color.y, pixel[2] = color.z;
}

}  // namespace

std::vector<float> sky_image(Vec3 to_sun, float turbidity, float albedo) {
  const Vec3 sun = baseline::normalize(to_sun);
  const Atmosphere air(turbidity, albedo, sun.y);
  const Colors colors;
  // The sky is the same on both sides of the sun's meridian: a row is computed at angles from
  // there.
  constexpr int kRows = kSkyHeight / 2 + 1, kAngles = kSkyWidth / 2;
  const float meridian = baseline::to_latlong({sun.x, 0.0f, sun.z}).x;
  const double sun_sine = std::sqrt(std::max(0.0, 1.0 - static_cast<double>(sun.y) * sun.y));
  std::vector<float> image(static_cast<size_t>(kSkyWidth) * kSkyHeight * 3);
  std::vector<Spectrum> falling(kRows);  // onto the ground, by row
#pragma omp parallel for schedule(dynamic, 1)
  for (int y = 0; y < kRows; ++y) {
    const baseline::DCosSin place = baseline::cos_sin_pi(static_cast<double>(y) / (kSkyHeight - 1));
    const double cosine = y + 1 < kRows ? place.c : 0.0, sine = place.s;
    // Half a cell of the row above and below; the horizon has only one above.
    const double upper = std::max(0.0, (y - 0.5) / (kSkyHeight - 1));
    const double lower = std::min(0.5, (y + 0.5) / (kSkyHeight - 1));
    const double solid_angle = 2.0 * kPiD * (baseline::cos_pi(upper) - baseline::cos_pi(lower));
    Vec3 row[kAngles + 1];
    for (int i = 0; i <= kAngles; ++i) {
      const double angle = static_cast<double>(i) / kAngles;
      const double between = sine * sun_sine * baseline::cos_pi(angle) + cosine * sun.y;
      const Spectrum s = air.sky(cosine, sun.y, std::clamp(between, -1.0, 1.0));
      const double share = (i == 0 || i == kAngles ? 0.5 : 1.0) / kAngles;
      for (int k = 0; k < kBands; ++k) falling[y][k] += s[k] * cosine * solid_angle * share;
      row[i] = colors.rgb(s);
    }
    for (u32 x = 0; x < kSkyWidth; ++x) {
      const float u = (static_cast<float>(x) + 0.5f) / kSkyWidth;
      const float away = std::abs(u - meridian);
      const float at = 2.0f * std::min(away, 1.0f - away) * kAngles;
      const int i = std::clamp(static_cast<int>(at), 0, kAngles - 1);
      set_pixel(image, x, static_cast<u32>(y), row[i] + (row[i + 1] - row[i]) * (at - i));
    }
  }
  Spectrum ground = air.from_sun(kGround + kEye, sun.y);
  for (double& g : ground) g *= std::max(0.0f, sun.y);
  for (const Spectrum& s : falling) {
    for (int k = 0; k < kBands; ++k) ground[k] += s[k];
  }
  for (double& g : ground) g *= static_cast<double>(albedo) / kPiD;
  const Vec3 color = colors.rgb(ground);
  for (u32 y = kRows; y < kSkyHeight; ++y) {
    for (u32 x = 0; x < kSkyWidth; ++x) set_pixel(image, x, y, color);
  }
  return image;
}

Vec3 sun_radiance(Vec3 to_sun, float turbidity, float angle) {
  const Vec3 sun = baseline::normalize(to_sun);
  Spectrum s = Transmission(Air(turbidity))(kGround + kEye, sun.y);
  // Irradiance over the disk's projected solid angle, pi sin^2 of its half angle.
  const double sine = baseline::cos_sin_pi(static_cast<double>(angle) / 360.0).s;
  for (double& x : s) x /= kPiD * sine * sine;
  return Colors().rgb(s);
}

}  // namespace parhelion
