// Which pixels of a batch of images exist. A tensor that has active sites holds them alone, sites x channels,
// in the order of images, rows and columns; all other pixels are absent: zeros to convolutions and bilinear
// taps, minus infinity to a maximum, no part of statistics, no tokens. Images of different coverage share a
// batch without padding. (Active sites: Graham et al., CVPR 2018; computing on a mask's tiles: SBNet, Ren et
// al., CVPR 2018.)
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

namespace opaline {

class ActiveSites {
 public:
  /// `active`: n x h x w, nonzero where a pixel exists.
  ActiveSites(int64_t n, int64_t h, int64_t w, std::span<const uint8_t> active);
  ActiveSites(const ActiveSites&) = delete;
  ActiveSites& operator=(const ActiveSites&) = delete;

  int64_t n() const { return n_; }
  int64_t h() const { return h_; }
  int64_t w() const { return w_; }
  int64_t count() const { return first_.back(); }
  /// Whether every pixel exists.
  bool full() const { return count() == n_ * h_ * w_; }
  /// Whether these are the same pixels.
  bool operator==(const ActiveSites& other) const;

  /// The site of a pixel of image, row and column within the images; -1 where it is absent.
  int64_t site(int64_t image, int64_t row, int64_t column) const {
    return index_[static_cast<size_t>((image * h_ + row) * w_ + column)];
  }
  /// First site of an image; that of image n is count().
  int64_t first(int64_t image) const { return first_[static_cast<size_t>(image)]; }

  /// Sites of neighbouring rows and columns, `line` sites from a row to the next.
  struct Rectangle {
    int64_t image, row, column, rows, columns;
    int64_t site;  ///< of the first pixel
    int64_t line;
  };
  /// All sites, each in one of them, from top to bottom.
  const std::vector<Rectangle>& rectangles() const { return rectangles_; }

  struct Tile {
    int64_t image, row, column;  ///< of the first pixel
  };
  /// Squares of `side` pixels that cover all sites: bands of `side` rows from the first row that has a site
  /// not yet covered, in each squares from the first such column. A full set gives the regular grid. Made
  /// once a side; safe to use from several threads.
  const std::vector<Tile>& tiles(int64_t side) const;

  /// The sites of half the size: those with an active pixel among their four. Made once. h and w must be
  /// even.
  const std::shared_ptr<const ActiveSites>& halved() const;

  /// The sites of the images with a border of `padding` pixels that shows what is mirrored at the edge
  /// (which is not repeated): a pixel of the border exists where the one that it shows does.
  ActiveSites mirrored(int64_t padding) const;

 private:
  ActiveSites(int64_t n, int64_t h, int64_t w);
  void number(std::span<const uint8_t> active);
  void find_rectangles();

  int64_t n_, h_, w_;
  std::vector<int32_t> index_;
  std::vector<int64_t> first_;
  std::vector<Rectangle> rectangles_;
  mutable std::mutex mutex_;
  mutable std::map<int64_t, std::vector<Tile>> tiles_;
  mutable std::shared_ptr<const ActiveSites> halved_;
};

/// The sites for a network that halves its images up to four times: the tiles of `tile` x `tile` pixels that
/// touch the mask or lie at most `dilation` tiles from one that does. mask: n x h x w, nonzero where the
/// object is; h and w must be multiples of `tile`.
std::shared_ptr<const ActiveSites> support_of(int64_t n, int64_t h, int64_t w, std::span<const uint8_t> mask,
                                              int64_t dilation = 0, int64_t tile = 16);

}  // namespace opaline
