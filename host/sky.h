// The clear sky and the sun, computed from the physics of the air.
#pragma once
#include <vector>

#include "../core/types.h"

namespace parhelion {

// Radiance of the sky and, below the horizon, of the ground, as an image of latitude and longitude
// (core/panorama.h): linear RGB whose luminance is in 1000 cd/m^2, rows from the zenith. Without
// the sun. `to_sun` has any length but 0; +y is up.
inline constexpr u32 kSkyWidth = 512, kSkyHeight = 257;
std::vector<float> sky_image(Vec3 to_sun, float turbidity, float albedo);

// Radiance of the sun's disk, spread over one of the given angular diameter in degrees.
Vec3 sun_radiance(Vec3 to_sun, float turbidity, float angle);

}  // namespace parhelion
