// Smooth dielectric interfaces (Born and Wolf, Principles of Optics, 1.5) and the closed forms of Atkinson
// and Hancock, "Recovery of surface orientation from diffuse polarization", IEEE TIP 2006.
#pragma once

namespace opaline::render {

/// Index of refraction of the objects (BK7, the paper's value); the exterior has 1.
inline constexpr double kRefractiveIndex = 1.5046;

/// What an interface does to a wave: power reflectances across (s) and in (p) the plane of incidence, and the
/// product r_s conj(r_p) of the amplitude coefficients, which turns and retards the rest of the polarisation.
/// Amplitudes are in frames (s, k x s) of the incoming and the outgoing direction k.
struct Fresnel {
  double reflect_s = 0;
  double reflect_p = 0;
  double cross_real = 0;
  double cross_imag = 0;    ///< other than 0 under total reflection only
  double cos_transmit = 0;  ///< cosine of the refracted ray's angle; 0 under total reflection
  bool total = false;

  double reflectance() const { return 0.5 * (reflect_s + reflect_p); }
};

/// `cos_incidence` in [0, 1]; `eta` = index behind the interface / index before it.
Fresnel fresnel(double cos_incidence, double eta);

/// Reflectance of perfectly diffuse light that arrives from the side of index 1 at one of index `eta`
/// (eta < 1: from inside), by quadrature to about 1e-10.
double diffuse_reflectance(double eta);

/// Degree of polarisation of unpolarised light reflected at zenith angle `angle` (radians), index n.
double specular_dop(double angle, double n);
/// Degree of polarisation of depolarised light that leaves at zenith angle `angle`.
double diffuse_dop(double angle, double n);

}  // namespace opaline::render
