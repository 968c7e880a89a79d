// From linear light to what the networks see, and back.
//
// A scene's Stokes images become four polariser images I0, I90 = (S0 +- S1) / 2, I45, I135 = (S0 +- S2) / 2,
// each clipped to [0, 1] after the exposure (data/sensor.h may do more to them); S0, S1, S2, max and min =
// (S0 +- sqrt(S1^2 + S2^2)) / 2 (the paper's equations) are computed from the clipped images; intensities are
// encoded as v = I^(1/2.2) (data/gamma.h), with an optional truncation to 8 bits (as the release's files were
// written), and enter as 2 v - 1.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/tensor.h"
#include "data/scene.h"
#include "data/sensor.h"

namespace opaline {

/// Selectable inputs; a network input is some of them, in the order listed.
enum class InputKind {
  kIntensity,   ///< 3: encoded S0 / 2, not masked
  kPol4,        ///< 12: encoded p0, p45, p90, p135, masked
  kMaxMin,      ///< 6: encoded max, min (min, max where EncodeOptions::min_first), masked
  kDopAop,      ///< 6: DoP, AoP in [0, pi), raw
  kEncodedAop,  ///< 6: cos 2 AoP (3), sin 2 AoP (3), raw
  kStokes,      ///< 9: linear S0, S1, S2, raw
  kMask,        ///< 1: -1 outside, +1 on the object
  kBackground,  ///< 3: encoded p0 outside the mask, -1 on the object
};

/// "intensity", "pol4", "maxmin", "dop_aop", "encoded_aop", "stokes", "mask", "background".
std::string_view to_string(InputKind kind);
/// Throws UsageError naming the known ones.
InputKind parse_input_kind(std::string_view name);
int64_t channels_of(InputKind kind);

struct EncodeOptions {
  std::vector<InputKind> inputs;
  bool min_first = false;             ///< order of kMaxMin
  bool quantise = false;              ///< truncate encoded images to 8 bits
  bool flash_in_illumination = true;  ///< illumination has 28 values, flash last; else 27
  bool flash_in_sss = false;          ///< SSS vector has 8 values, flash last; else 7

  /// p0, p45, p90, p135, max, min, mask: 19 channels; flash with the illumination.
  static EncodeOptions paper();
  /// p0, p45, p90, p135, background, min, max: 21 channels, 8 bits; flash with the SSS values.
  static EncodeOptions release();
};

int64_t input_channels(const EncodeOptions& options);
int64_t illumination_values(const EncodeOptions& options);
int64_t sss_values(const EncodeOptions& options);

/// Which tensors to make; those of things that the scene lacks stay undefined.
struct EncodeWanted {
  bool targets = true;         ///< normal, depth, illumination, sss
  bool reconstruction = true;  ///< bsdf and polarised
  /// Of a batch: all images but the input as active sites, of the tiles that touch the mask and so many tiles
  /// around them (support_of).
  std::optional<int64_t> support = {};
};

/// Whether light outside the object is looked at: the masked inputs (pol4, maxmin, mask) need none, the
/// reconstruction's pure-BSDF images are not masked, but their support may be enough.
bool needs_whole_image(const EncodeOptions& options, const EncodeWanted& wanted);

/// One scene as the networks take it; float32, channels last.
struct Sample {
  std::string id;
  Tensor input;         ///< H x W x input_channels
  Tensor normal;        ///< H x W x 3, camera axes, 0 outside the mask
  Tensor depth;         ///< H x W x 1, 0 outside the mask
  Tensor mask;          ///< H x W x 1 of 0 and 1
  Tensor illumination;  ///< 27 SH, colour-major; with flash_in_illumination the mapped flash last
  Tensor sss;           ///< g, sigma_t (3), albedo (3), each mapped to [-1, 1]; with flash_in_sss flash last
  Tensor bsdf;          ///< H x W x 12, pure-BSDF p0, p45, p90, p135 as 2 v - 1, not masked
  Tensor polarised;     ///< H x W x 12, p0, p45, p90, p135 as 2 v - 1, masked: what is reconstructed
};

/// A scene that could not be read, and the sample of the batch where another stands in for it.
struct ReplacedScene {
  int64_t sample = 0;
  std::string id;
  std::string what;  ///< the reader's message
};

/// Samples stacked: every tensor has a leading N; undefined where a sample's is. With EncodeWanted::support
/// normal, depth, mask, bsdf and polarised hold active sites.
struct Batch {
  std::vector<std::string> ids;
  Tensor input;
  Tensor normal;
  Tensor depth;
  Tensor mask;
  Tensor illumination;
  Tensor sss;
  Tensor bsdf;
  Tensor polarised;
  int64_t epoch = 0;  ///< where the loader took it from
  int64_t index = 0;  ///< batch of the epoch, all ranks counted
  std::vector<ReplacedScene> replaced = {};

  int64_t size() const { return static_cast<int64_t>(ids.size()); }
};

/// The illumination's labels and the flash grow with the shot's gains.
/// Throws Error naming the scene where its size is not divisible by 16 or is under 32 (the message says what
/// to crop or resize to), or where light was not read that the inputs need.
Sample encode_scene(const Scene& scene, const EncodeOptions& options, const EncodeWanted& wanted = {},
                    const Shot& shot = {});

/// Encodes scene by scene straight into the tensors of a batch.
class BatchBuilder {
 public:
  /// A batch of `samples`; the first scene decides the size and which tensors there are.
  BatchBuilder(int64_t samples, const EncodeOptions& options, const EncodeWanted& wanted);
  /// Throws as encode_scene and make_batch do.
  void add(const Scene& scene, const Shot& shot = {});
  int64_t size() const { return batch_.size(); }
  /// The batch, when all samples are added.
  Batch take();

 private:
  float* add_row(size_t field, const std::string& id, const Shape& shape);
  float* add_part(size_t field, const std::string& id, const Shape& shape, Sample& part);

  int64_t samples_;
  EncodeOptions options_;
  EncodeWanted wanted_;
  Batch batch_;
  // With a support, how much there is of each image is known at the end.
  std::vector<Sample> ragged_;
  std::vector<uint8_t> masks_;
};

/// Throws Error naming two scenes whose sizes differ, or of which only one has some truth.
Batch make_batch(std::span<const Sample> samples);

/// Physical values behind the SSS vector.
struct SssValues {
  float g = 0;
  std::array<float, 3> sigma_t{};  ///< per metre
  std::array<float, 3> albedo{};
  float flash = 0;  ///< radiance; meaningful where the vector has it
};

// The maps between physical values and [-1, 1] (g in [0, 0.9], sigma_t / 32 in [0, 1], albedo in
// [0.3, 0.95], flash / 100 in [0.35, 0.75]); they do not clamp.
float map_g(float g);
float map_sigma_t(float per_metre);
float map_albedo(float albedo);
float map_flash(float radiance);
float unmap_g(float mapped);
float unmap_sigma_t(float mapped);
float unmap_albedo(float mapped);
float unmap_flash(float mapped);

/// A network's SSS vector (7 or 8 values) in physical units.
SssValues decode_sss(std::span<const float> mapped);

/// v = I^(1/2.2) of I clipped to [0, 1].
float encode_gamma(float linear);
/// The reverse.
float decode_gamma(float encoded);

/// The polariser images p0, p45, p90, p135 of a Stokes image, in linear light,
/// clipped to [0, 1] after `exposure`. `stokes` is H x W x 9, the result H x W x 12 (image-major).
std::vector<float> polariser_images(std::span<const float> stokes, float exposure = 1.0F);

/// Bytes for a PNG: round(255 v) of v clipped to [0, 1].
uint8_t to_byte(float value);

}  // namespace opaline
