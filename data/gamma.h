// The power function of the encoding, v = I^(1/2.2), for many values at once: Highway, the instruction set
// picked at run time.
//
// I = m 2^e with m in [1, 2), so v = m^(5/11) 2^(5e/11): a polynomial of degree 7 (relative error 2.2e-8)
// times a table by exponent. Products and sums are not fused, so every instruction set gives the same bits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace opaline {

/// v = I^(1/2.2) of I clipped to [0, 1], within 3e-7 of v. NaN and anything under 2^-126 give 0.
/// `encoded` may be `linear`.
void encode_gamma(std::span<const float> linear, float* encoded);
/// 2 v - 1.
void encode_network(std::span<const float> linear, float* encoded);
/// floor(255 v), exactly that of double precision, as whole floats from 0 to 255.
void encode_8bit(std::span<const float> linear, float* levels);
/// 2 floor(255 v) / 255 - 1, correctly rounded.
void encode_network_8bit(std::span<const float> linear, float* encoded);

/// The light of a level, ((level + 0.5) / 255)^2.2 but at most 1: what truncation to 8 bits left is found
/// again in the middle.
float decode_8bit(uint8_t level);

}  // namespace opaline
