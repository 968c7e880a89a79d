#include "data/loader.h"

#include <atomic>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

constexpr int kSize = 32;

/// Scenes made on the fly; scene i has light that tells i, and scene `broken` cannot be read.
class CountedSet final : public Dataset {
 public:
  explicit CountedSet(int64_t scenes, int64_t broken = -1) : scenes_(scenes), broken_(broken) {}

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override { return split == Split::kTrain ? scenes_ : 0; }
  std::string id(Split, int64_t index) const override { return fmt::format("s{}", index); }
  Scene load(Split, int64_t index, const LoadOptions&) const override {
    ++loads;
    if (index == broken_) throw Error("the file ends early");
    Scene scene;
    scene.id = id(Split::kTrain, index);
    scene.width = kSize;
    scene.height = kSize;
    const float light = static_cast<float>(index + 1) / 1000;
    scene.image.assign(static_cast<size_t>(kSize * kSize * 9), 0.0F);
    for (size_t i = 0; i < scene.image.size(); i += 9) scene.image[i] = light;
    scene.mask.assign(static_cast<size_t>(kSize * kSize), 1);
    return scene;
  }
  mutable std::atomic<int> loads = 0;

 private:
  DatasetFacts facts_{.layout = "test", .root = "counted", .fingerprint = "0"};
  int64_t scenes_;
  int64_t broken_;
};

LoaderOptions small_options() {
  LoaderOptions options;
  options.batch = 4;
  options.min_last = 3;
  options.seed = 5;
  options.epochs = 3;
  options.encode.inputs = {InputKind::kStokes};
  return options;
}

std::vector<std::vector<std::string>> all_ids(Loader& loader) {
  std::vector<std::vector<std::string>> ids;
  while (const std::optional<Batch> batch = loader.next()) ids.push_back(batch->ids);
  return ids;
}

TEST_CASE("a short last batch joins the one before", "[loader]") {
  CHECK(batch_sizes(32, 16, 8) == std::vector<int64_t>{16, 16});
  CHECK(batch_sizes(39, 16, 8) == std::vector<int64_t>{16, 23});
  CHECK(batch_sizes(40, 16, 8) == std::vector<int64_t>{16, 16, 8});
  CHECK(batch_sizes(5, 16, 8) == std::vector<int64_t>{5});
  CHECK(batch_sizes(33, 16, 1) == std::vector<int64_t>{16, 16, 1});
}

TEST_CASE("every epoch has every scene once, in an order of its own", "[loader]") {
  const std::vector<int64_t> first = epoch_order(100, 9, 0, true);
  CHECK(std::set<int64_t>(first.begin(), first.end()).size() == 100);
  CHECK(first == epoch_order(100, 9, 0, true));
  CHECK(first != epoch_order(100, 9, 1, true));
  CHECK(first != epoch_order(100, 10, 0, true));
  const std::vector<int64_t> plain = epoch_order(5, 9, 3, false);
  CHECK(plain == std::vector<int64_t>{0, 1, 2, 3, 4});
}

TEST_CASE("the order does not depend on threads or prefetch", "[loader]") {
  const auto set = std::make_shared<CountedSet>(13);
  std::vector<std::vector<std::string>> reference;
  for (const int threads : {1, 2, 5}) {
    for (const int64_t prefetch : {1, 3}) {
      LoaderOptions options = small_options();
      options.threads = threads;
      options.prefetch = prefetch;
      Loader loader(set, options);
      CHECK(loader.batches_per_epoch() == 3);  // 4, 4, 4 + 1
      const auto ids = all_ids(loader);
      REQUIRE(ids.size() == 9);
      CHECK(ids[2].size() == 5);
      if (reference.empty()) reference = ids;
      CHECK(ids == reference);
    }
  }
}

TEST_CASE("batches hold the scenes they name", "[loader]") {
  LoaderOptions options = small_options();
  options.threads = 2;
  Loader loader(std::make_shared<CountedSet>(13), options);
  int64_t count = 0;
  while (const std::optional<Batch> batch = loader.next()) {
    CHECK(batch->epoch == count / 3);
    CHECK(batch->index == count % 3);
    for (int64_t i = 0; i < batch->size(); ++i) {
      const std::string& id = batch->ids[static_cast<size_t>(i)];
      const double light = batch->input.at(i * kSize * kSize * 9);
      REQUIRE(light == Approx((std::stod(id.substr(1)) + 1) / 1000));
    }
    ++count;
  }
  CHECK(count == 9);
}

TEST_CASE("a loader resumes at any batch", "[loader]") {
  const auto set = std::make_shared<CountedSet>(13);
  Loader whole(set, small_options());
  const auto reference = all_ids(whole);
  for (int64_t taken = 0; taken <= 9; ++taken) {
    Loader first(set, small_options());
    for (int64_t i = 0; i < taken; ++i) first.next();
    const LoaderPosition position = first.position();
    CHECK(position == LoaderPosition{taken / 3, taken % 3});
    Loader second(set, small_options(), position);
    const auto rest = all_ids(second);
    REQUIRE(rest.size() == reference.size() - static_cast<size_t>(taken));
    CHECK(std::equal(rest.begin(), rest.end(), reference.begin() + taken));
  }
}

TEST_CASE("prefetch is bounded", "[loader]") {
  const auto set = std::make_shared<CountedSet>(100);
  LoaderOptions options = small_options();
  options.prefetch = 2;
  options.threads = 4;
  Loader loader(set, options);
  loader.next();
  // Time for the threads to run ahead, if anything let them.
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  CHECK(set->loads <= 3 * 4);
}

TEST_CASE("a damaged scene is named where its batch is due", "[loader]") {
  LoaderOptions options = small_options();
  options.shuffle = false;
  options.threads = 2;
  Loader loader(std::make_shared<CountedSet>(13, 6), options);
  CHECK(loader.next().has_value());
  for (int again = 0; again < 2; ++again) {
    const std::string message = message_of([&] { loader.next(); });
    CHECK(contains(message, "scene s6"));
    CHECK(contains(message, "the file ends early"));
  }
}

TEST_CASE("the cache keeps scenes up to its bound", "[loader]") {
  const int64_t scene_bytes = kSize * kSize * (9 * 4 + 1);
  for (const int64_t kept : {0, 5, 13}) {
    const auto set = std::make_shared<CountedSet>(13);
    LoaderOptions options = small_options();
    options.shuffle = false;
    options.cache_bytes = kept * scene_bytes;
    Loader loader(set, options);
    const auto ids = all_ids(loader);
    CHECK(ids.size() == 9);
    CHECK(set->loads == 13 + 2 * (13 - static_cast<int>(kept)));
  }
}

TEST_CASE("a loader may be dropped at any time", "[loader]") {
  const auto set = std::make_shared<CountedSet>(50);
  for (int trial = 0; trial < 20; ++trial) {
    LoaderOptions options = small_options();
    options.epochs = 0;
    options.threads = 3;
    Loader loader(set, options);
    for (int i = 0; i < trial % 4; ++i) loader.next();
  }
  CHECK(set->loads > 0);
}

TEST_CASE("an empty split and senseless sizes are explained", "[loader]") {
  LoaderOptions options = small_options();
  CHECK(contains(message_of([&] { Loader loader(std::make_shared<CountedSet>(0), options); }), "no scenes"));
  options.batch = 0;
  CHECK_THROWS_AS(Loader(std::make_shared<CountedSet>(3), options), UsageError);
  options.batch = 4;
  CHECK_THROWS_AS(Loader(std::make_shared<CountedSet>(3), options, {0, 7}), UsageError);
  options.max_samples = 2;
  CHECK(Loader(std::make_shared<CountedSet>(3), options).samples() == 2);
}

TEST_CASE("a loader streams a data set of ours", "[loader]") {
  const TempFolder folder;
  write_small_set(folder.path(), 6, 0);
  LoaderOptions options;
  options.batch = 3;
  options.min_last = 1;
  options.epochs = 1;
  options.threads = 2;
  Loader loader(std::shared_ptr<const Dataset>(open_dataset(folder.path())), options);
  int64_t samples = 0;
  while (const std::optional<Batch> batch = loader.next()) {
    CHECK(batch->input.shape() == Shape{3, 32, 32, 19});
    CHECK(batch->bsdf.shape() == Shape{3, 32, 32, 12});
    CHECK(batch->illumination.shape() == Shape{3, 28});
    samples += batch->size();
  }
  CHECK(samples == 6);
}

}  // namespace
}  // namespace opaline::test
