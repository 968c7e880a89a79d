// Rays on their way through a world, from surface to surface and from scattering to scattering. Paths from
// the camera (data/render/path.h) and from the light (data/render/light_paths.h) are made of them.
#pragma once

#include <cstdint>
#include <span>

#include "core/random.h"
#include "data/render/fresnel.h"
#include "data/render/geometry.h"
#include "data/render/guide.h"
#include "data/render/light.h"
#include "data/render/medium.h"
#include "data/render/mueller.h"
#include "data/render/sequence.h"

namespace opaline::render {

/// What a path may meet. The pointers must outlive it.
struct World {
  const Geometry* geometry = nullptr;
  const Light* light = nullptr;
  Medium medium{};
  double index = kRefractiveIndex;
  const Guide* guide = nullptr;  ///< null: phase function alone
  /// Queries inside the medium end where the free flight does; else they look for the surface and compare.
  bool bounded_queries = true;
};

/// Paths that numerical errors cut short: a ray inside the closed surface that met nothing, or met it from
/// the wrong side.
struct PathFaults {
  int64_t lost = 0;
  int64_t paths = 0;
};

/// Two random numbers in [0, 1) that a free flight is drawn from.
struct FlightNumbers {
  double channel = 0;   ///< chooses the colour whose flight it is
  double distance = 0;  ///< draws that flight
};

/// The first random numbers of a walk, in [0, 1): a low-discrepancy sequence can take their place.
struct FirstNumbers {
  FlightNumbers flight;  ///< the first one
  double light = 0;      ///< chooses the guide's bin of directions at the first scattering
  double cosine = 0;     ///< .. and the direction of the phase function there
  double azimuth = 0;
  FlightNumbers second;  ///< flight, after that

  static constexpr size_t kCount = 7;
  explicit FirstNumbers(std::span<const double, kCount> u)
      : flight{u[0], u[1]}, light(u[2]), cosine(u[3]), azimuth(u[4]), second{u[5], u[6]} {}
  explicit FirstNumbers(Random& random) : FirstNumbers(uniform<kCount>(random)) {}
};

struct Ray {
  Vec3 origin;
  Vec3 direction;  ///< unit
  bool inside = false;
  int flights = 0;  ///< inside, since the ray left the surface
};

/// What a surface does to a ray.
struct Crossing {
  Fresnel fresnel;
  double eta;  ///< index behind / index before
};

enum class End { kEscaped, kScattered, kLost, kStopped };

/// After so many surface events a path goes on with this probability only: a ray may be caught between
/// totally reflecting faces. Nearly all find a way out within a thousand; earlier roulette would cost far
/// more noise than it saves time.
inline constexpr int kSureEvents = 1000;
inline constexpr double kGoOn = 0.9;

/// Moves rays. It exists for the length of one path.
class Walk {
 public:
  /// All must outlive it.
  Walk(const World& world, Random& random) : world_(world), random_(random) {}

  Meeting next(const Ray& ray, double limit, Hit& hit) const {
    return world_.geometry->next(ray.origin, ray.direction, ray.inside, limit, hit);
  }
  Crossing meet(const Hit& hit, const Ray& ray) const;
  /// Sends the ray along one of the two branches, which was chosen with this probability.
  template <int R>
  void branch(const Hit& hit, const Crossing& crossing, bool reflects, double probability, Ray& ray,
              Response<R>& response) const;
  /// Reflects or refracts the ray, with the probability of unpolarised light.
  template <int R>
  void cross(const Hit& hit, Ray& ray, Response<R>& response);
  /// Moves the ray, which the medium may scatter, until it is scattered or leaves the scene. `beta` gets what
  /// the medium leaves of each colour before the albedo, over the probability; `length` what lies inside up
  /// to the last surface. By reciprocity the response serves light that is traced forwards as well
  /// (data/render/mueller.h).
  template <int R>
  End fly(Ray& ray, Response<R>& response, Rgb& beta, double& length, const FlightNumbers* first = nullptr);

 private:
  const World& world_;
  Random& random_;
};

/// The unit direction of the ray that the surface reflects, and of the one that it refracts.
Vec3 reflect(const Vec3& direction, const Vec3& normal);
/// `normal` towards the side that `direction` comes from, `eta` = index behind / index before.
Vec3 refract(const Vec3& direction, const Vec3& normal, const Fresnel& f, double eta);

}  // namespace opaline::render
