// Which algorithm each convolution runs: chosen once a shape and pass, kept, and written down, so that a run
// that is resumed makes the same choices even if the rule has changed since.
#pragma once

#include <compare>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>

#include "core/kernels/image.h"
#include "core/numerics.h"

namespace opaline::kernels {

/// Shape of conv2d: x is n x h x w x in, y is n x out_h x out_w x out, the weight out x in x kernel_h x
/// kernel_w. Around x lie `padding` pixels of zeros, or of its mirror image with `reflect`.
struct ConvShape {
  int64_t n = 0, h = 0, w = 0, in = 0;
  int64_t out = 0, kernel_h = 0, kernel_w = 0;
  int64_t stride = 1, padding = 0;
  bool reflect = false;
  /// The share of the input's pixels that exist, rounded up to sixteenths: all that choosing an algorithm
  /// knows of active sites.
  int64_t sixteenths = 16;

  auto operator<=>(const ConvShape&) const = default;
  int64_t out_h() const { return (h + 2 * padding - kernel_h) / stride + 1; }
  int64_t out_w() const { return (w + 2 * padding - kernel_w) / stride + 1; }
  template <class T>
  Image<T> input(const T* x, const ActiveSites* sites = nullptr) const {
    return {x, n, h, w, in, reflect ? padding : 0, sites};
  }
  template <class T>
  Image<T> output(const T* y, const ActiveSites* sites = nullptr) const {
    return {y, n, out_h(), out_w(), out, 0, sites};
  }
};

/// "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1 mirrored, 3/16 of the pixels"; back from it, or an
/// Error. Reads eighths, too, which earlier plans have.
std::string to_string(const ConvShape& s);
ConvShape parse_conv_shape(std::string_view text);

enum class ConvPass { kForward, kInputGradient, kWeightGradient };
/// "forward", "input gradient", "weight gradient".
std::string_view to_string(ConvPass pass);

/// Whether Winograd's algorithm with tiles of `outputs` a side can do this shape: F(2x2), F(4x4) and F(6x6)
/// kernels of 3 x 3; F(3x3, 4x4), with tiles of 3, kernels of 5 x 5 to 8 x 8.
inline bool winograd_fits(const ConvShape& s, int outputs) {
  const bool square = s.kernel_h == s.kernel_w && s.stride == 1 && s.padding < s.kernel_h;
  if (outputs == 3) return square && s.kernel_h > 4 && s.kernel_h <= 8;
  return square && s.kernel_h == 3 && (outputs == 2 || outputs == 4 || outputs == 6);
}

/// Outputs a side of the tiles of Winograd's algorithm that should be fastest for a pass over this shape, or
/// 0 for the direct one, among those whose error the numerics admit: strict F(2x2), but not for gradients of
/// weights, balanced also F(4x4) and F(3x3, 4x4), fast also F(6x6).
int choose_algorithm(const ConvShape& s, ConvPass pass, Numerics numerics);

/// Safe to use from several threads.
class ConvPlan {
 public:
  explicit ConvPlan(Numerics numerics) : numerics_(numerics) {}
  Numerics numerics() const { return numerics_; }

  /// The choice for a shape and pass: as it was made before, or by choose_algorithm().
  int outputs(const ConvShape& s, ConvPass pass);

  /// All choices so far as JSON, in a fixed order: {"numerics": .., "convolutions": {shape: {pass:
  /// outputs}}}.
  std::string to_json() const;
  /// Takes over the choices of a text; an Error names `source` where it is none or of other numerics.
  void load(std::string_view json, std::string_view source);

 private:
  using Key = std::pair<ConvShape, ConvPass>;
  Numerics numerics_;
  mutable std::mutex mutex_;
  std::map<Key, int> choices_;
};

/// The numerics that a plan's JSON was made for; an Error names `source` where it is none.
Numerics planned_numerics(std::string_view json, std::string_view source);

}  // namespace opaline::kernels
