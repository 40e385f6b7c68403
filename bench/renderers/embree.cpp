// Rays against triangles or spheres by Embree 4, an array of them at a time: what rays.py calls.
// The library is that of embreex's wheel, which has no headers and whose own module knows no
// spheres, so what is needed of embree4/rtcore.h is declared here.
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#if defined(__SSE__)
#include <xmmintrin.h>
#endif

extern "C" {

struct RTCRay {
  float origin[3], near, direction[3], time, far;
  unsigned mask, id, flags;
};
// Longer than any version of 4 has it: ids of instances, of which there are none, come last.
struct alignas(16) RTCRayHit {
  RTCRay ray;
  float normal[3], u, v;
  unsigned primitive, geometry, instance[27];
};

// Sixteen of them, by component.
struct alignas(64) RTCRay16 {
  float origin[3][16], near[16], direction[3][16], time[16], far[16];
  unsigned mask[16], id[16], flags[16];
};
struct RTCRayHit16 {
  RTCRay16 ray;
  float normal[3][16], u[16], v[16];
  unsigned primitive[16], geometry[16], instance[27][16];
};
// And longer than any version has it.
struct RTCArguments {
  int flags;
  unsigned features;
  void* more[8];
};

static_assert(sizeof(RTCRay) == 48 && offsetof(RTCRayHit, geometry) == 72);
static_assert(sizeof(RTCRay16) == 768 && offsetof(RTCRayHit16, geometry) == 1152);

void* rtcNewDevice(const char* config);
void* rtcNewScene(void* device);
void* rtcNewGeometry(void* device, int type);
void* rtcSetNewGeometryBuffer(void* geometry, int buffer, unsigned slot, int format,
                              std::size_t stride, std::size_t count);
void rtcCommitGeometry(void* geometry);
unsigned rtcAttachGeometry(void* scene, void* geometry);
void rtcReleaseGeometry(void* geometry);
void rtcSetSceneFlags(void* scene, int flags);
void rtcCommitScene(void* scene);
void rtcReleaseScene(void* scene);
void rtcIntersect1(void* scene, RTCRayHit* ray, void* arguments);
void rtcOccluded1(void* scene, RTCRay* ray, void* arguments);
void rtcIntersect16(const int* valid, void* scene, RTCRayHit16* rays, RTCArguments* arguments);
void rtcOccluded16(const int* valid, void* scene, RTCRay16* rays, RTCArguments* arguments);

}  // extern "C"

namespace {

constexpr int kTriangles = 0, kSpheres = 50;                             // RTCGeometryType
constexpr int kIndices = 0, kVertices = 1;                               // RTCBufferType
constexpr int kThreeUnsigned = 0x5003, kThree = 0x9003, kFour = 0x9004;  // RTCFormat
constexpr int kRobust = 4;                                               // RTCSceneFlags
constexpr int kCoherent = 1 << 16;                                       // RTCRayQueryFlags

// Denormal numbers count as 0, as Embree's manual recommends.
class FlushDenormals {
#if defined(__SSE__)
 public:
  FlushDenormals() { _mm_setcsr(before_ | 0x8040); }
  ~FlushDenormals() { _mm_setcsr(before_); }

 private:
  const unsigned before_ = _mm_getcsr();
#endif
};

RTCRay ray_of(const float* origin, const float* direction) {
  RTCRay ray = {};
  std::memcpy(ray.origin, origin, sizeof(ray.origin));
  std::memcpy(ray.direction, direction, sizeof(ray.direction));
  ray.far = INFINITY;
  ray.mask = ~0u;
  return ray;
}

// Calls f(first, count, valid, rays) for each sixteen of many rays, of which `count` are there.
template <class F>
void for_each_packet(const float* origins, const float* directions, std::size_t n, F&& f) {
  for (std::size_t first = 0; first < n; first += 16) {
    const std::size_t count = n - first < 16 ? n - first : 16;
    alignas(64) int valid[16];
    RTCRay16 rays = {};
    for (std::size_t k = 0; k < 16; ++k) {
      const std::size_t i = first + (k < count ? k : 0);
      valid[k] = k < count ? -1 : 0;
      for (int axis = 0; axis < 3; ++axis) {
        rays.origin[axis][k] = origins[3 * i + axis];
        rays.direction[axis][k] = directions[3 * i + axis];
      }
      rays.far[k] = INFINITY;
      rays.mask[k] = ~0u;
    }
    f(first, count, valid, rays);
  }
}

void fill(void* geometry, int buffer, int format, const void* from, std::size_t stride,
          std::size_t count) {
  void* to = rtcSetNewGeometryBuffer(geometry, buffer, 0, format, stride, count);
  if (!to) std::abort();
  std::memcpy(to, from, stride * count);
}

// What is one geometry, whose buffers fill_buffers makes. Built at Embree's default quality,
// medium. robust: few rays pass between neighbours, and numbers are exacter.
template <class Fill>
void* scene_of(int type, bool robust, Fill&& fill_buffers) {
  static void* const device = rtcNewDevice(nullptr);
  void* geometry = rtcNewGeometry(device, type);
  fill_buffers(geometry);
  rtcCommitGeometry(geometry);
  void* scene = rtcNewScene(device);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneFlags(scene, robust ? kRobust : 0);
  rtcCommitScene(scene);
  return scene;
}

}  // namespace

extern "C" {

// vertices: three floats each; faces: three numbers of vertices each.
void* embree_triangles(const float* vertices, std::size_t vertex_count, const unsigned* faces,
                       std::size_t face_count, bool robust) {
  return scene_of(kTriangles, robust, [&](void* geometry) {
    fill(geometry, kVertices, kThree, vertices, 3 * sizeof(float), vertex_count);
    fill(geometry, kIndices, kThreeUnsigned, faces, 3 * sizeof(unsigned), face_count);
  });
}

// Centre and radius each, four floats.
void* embree_spheres(const float* spheres, std::size_t count, bool robust) {
  return scene_of(kSpheres, robust, [&](void* geometry) {
    fill(geometry, kVertices, kFour, spheres, 4 * sizeof(float), count);
  });
}

void embree_release(void* scene) { rtcReleaseScene(scene); }

// origins and directions: three floats a ray. distances: infinite where nothing is hit.
void embree_nearest(void* scene, const float* origins, const float* directions, std::size_t count,
                    float* distances) {
  const FlushDenormals flush;
  for (std::size_t i = 0; i < count; ++i) {
    RTCRayHit hit;
    hit.ray = ray_of(origins + 3 * i, directions + 3 * i);
    hit.geometry = hit.instance[0] = ~0u;
    rtcIntersect1(scene, &hit, nullptr);
    distances[i] = hit.geometry == ~0u ? INFINITY : hit.ray.far;
  }
}

// hits: whether anything is, a byte a ray.
void embree_any(void* scene, const float* origins, const float* directions, std::size_t count,
                unsigned char* hits) {
  const FlushDenormals flush;
  for (std::size_t i = 0; i < count; ++i) {
    alignas(16) RTCRay ray = ray_of(origins + 3 * i, directions + 3 * i);
    rtcOccluded1(scene, &ray, nullptr);
    hits[i] = ray.far < 0.0f;
  }
}

// The same by sixteen rays together, which lie close to each other.
void embree_nearest16(void* scene, const float* origins, const float* directions, std::size_t count,
                      float* distances) {
  const FlushDenormals flush;
  RTCArguments arguments = {kCoherent, ~0u, {}};
  for_each_packet(origins, directions, count,
                  [&](std::size_t first, std::size_t n, const int* valid, const RTCRay16& rays) {
                    RTCRayHit16 hit;
                    hit.ray = rays;
                    std::memset(hit.geometry, -1, sizeof(hit.geometry));
                    std::memset(hit.instance[0], -1, sizeof(hit.instance[0]));
                    rtcIntersect16(valid, scene, &hit, &arguments);
                    for (std::size_t k = 0; k < n; ++k) {
                      distances[first + k] = hit.geometry[k] == ~0u ? INFINITY : hit.ray.far[k];
                    }
                  });
}
void embree_any16(void* scene, const float* origins, const float* directions, std::size_t count,
                  unsigned char* hits) {
  const FlushDenormals flush;
  RTCArguments arguments = {kCoherent, ~0u, {}};
  for_each_packet(origins, directions, count,
                  [&](std::size_t first, std::size_t n, const int* valid, RTCRay16& rays) {
                    rtcOccluded16(valid, scene, &rays, &arguments);
                    for (std::size_t k = 0; k < n; ++k) hits[first + k] = rays.far[k] < 0.0f;
                  });
}

}  // extern "C"
