#include "data/loader.h"

#include <malloc.h>

#include <atomic>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include "core/memory.h"
#include "core/ops/sites.h"
#include "tests/data/support.h"

namespace opaline::test {
namespace {

constexpr int kSize = 32;

/// Scenes made on the fly; scene i has light that tells i, and `broken` ones cannot be read.
class CountedSet final : public Dataset {
 public:
  explicit CountedSet(int64_t scenes, std::set<int64_t> broken = {})
      : scenes_(scenes), broken_(std::move(broken)) {}

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override { return split == Split::kTrain ? scenes_ : 0; }
  std::string id(Split, int64_t index) const override { return fmt::format("s{}", index); }
  Scene load(Split, int64_t index, const LoadOptions&) const override {
    ++loads;
    if (broken_.contains(index)) throw Error("the file ends early");
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
  std::set<int64_t> broken_;
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

int64_t options_prefetch() {
  return LoaderOptions().prefetch;
}

/// Bytes that malloc has given out; 0 under a sanitizer's allocator.
int64_t heap_bytes() {
  const struct mallinfo2 info = ::mallinfo2();
  return static_cast<int64_t>(info.uordblks + info.hblkhd);
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
  Loader loader(std::make_shared<CountedSet>(13, std::set<int64_t>{6}), options);
  CHECK(loader.next().has_value());
  for (int again = 0; again < 2; ++again) {
    const std::string message = message_of([&] { loader.next(); });
    CHECK(contains(message, "scene s6"));
    CHECK(contains(message, "the file ends early"));
  }
}

TEST_CASE("ranks share every epoch, in the order of one", "[loader]") {
  const auto set = std::make_shared<CountedSet>(45);
  LoaderOptions options = small_options();
  options.epochs = 2;
  std::vector<std::string> alone;
  Loader one(set, options);
  for (const auto& batch : all_ids(one)) alone.insert(alone.end(), batch.begin(), batch.end());
  REQUIRE(alone.size() == 90);
  for (const int64_t ranks : {2, 3, 4, 7}) {
    options.ranks = ranks;
    std::vector<std::vector<std::vector<std::string>>> shares;
    for (options.rank = 0; options.rank < ranks; ++options.rank) {
      Loader loader(set, options);
      shares.push_back(all_ids(loader));
      CHECK(shares.back().size() == shares.front().size());
      CHECK(static_cast<int64_t>(shares.back().size()) == 2 * loader.batches_per_epoch());
    }
    options.rank = 0;
    std::vector<std::string> together;
    for (size_t batch = 0; batch < shares[0].size(); ++batch) {
      for (const auto& share : shares)
        together.insert(together.end(), share[batch].begin(), share[batch].end());
    }
    CHECK(together == alone);
  }
  CHECK(batch_sizes(45, 4, 3, 2) ==
        std::vector<int64_t>{4, 4, 4, 4, 4, 4, 4, 4, 7, 6});  // 5 are too few for two
  CHECK(batch_sizes(46, 4, 3, 2) == std::vector<int64_t>{4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3});
  CHECK(contains(message_of([] { batch_sizes(3, 4, 1, 4); }), "too few for 4 ranks"));
  options.rank = 7;
  CHECK_THROWS_AS(Loader(set, options), UsageError);
}

TEST_CASE("a run goes on in the same order with another number of ranks", "[loader]") {
  const auto set = std::make_shared<CountedSet>(45);
  LoaderOptions options = small_options();
  options.epochs = 2;
  std::vector<std::string> alone;
  Loader one(set, options);
  for (const auto& batch : all_ids(one)) alone.insert(alone.end(), batch.begin(), batch.end());
  for (const auto& [before, after] : {std::pair<int64_t, int64_t>{1, 2}, {2, 3}, {3, 2}, {2, 1}}) {
    for (int64_t rounds = 0; rounds <= 3; ++rounds) {
      options.ranks = before;
      options.rank = 0;
      Loader first(set, options);
      for (int64_t i = 0; i < rounds; ++i) first.next();
      const LoaderPosition position = first.position();
      CHECK(position == LoaderPosition{0, rounds * before});
      options.ranks = after;
      std::vector<std::vector<std::vector<std::string>>> shares;
      for (options.rank = 0; options.rank < after; ++options.rank) {
        Loader loader(set, options, position);
        shares.push_back(all_ids(loader));
      }
      std::vector<std::string> rest;
      for (size_t batch = 0; batch < shares[0].size(); ++batch) {
        for (const auto& share : shares) rest.insert(rest.end(), share[batch].begin(), share[batch].end());
      }
      const auto taken = static_cast<std::ptrdiff_t>(4 * rounds * before);
      CHECK(std::vector<std::string>(alone.begin() + taken, alone.end()) == rest);
    }
  }
}

TEST_CASE("the next scene of the order stands in for a damaged one", "[loader]") {
  const auto set = std::make_shared<CountedSet>(13, std::set<int64_t>{2, 6, 7});
  LoaderOptions options = small_options();
  options.shuffle = false;
  options.damaged = DamagePolicy::kSkip;
  std::vector<std::vector<std::string>> reference;
  for (const int threads : {1, 4}) {
    options.threads = threads;
    Loader loader(set, options);
    std::vector<std::vector<std::string>> ids;
    int64_t replaced = 0;
    while (const std::optional<Batch> batch = loader.next()) {
      ids.push_back(batch->ids);
      for (const ReplacedScene& scene : batch->replaced) {
        CHECK(set->id(Split::kTrain, 4 * batch->index + scene.sample) == scene.id);
        CHECK(contains(scene.what, "the file ends early"));
        ++replaced;
      }
    }
    CHECK(replaced == 3 * 3);
    REQUIRE(ids.size() == 9);
    CHECK(ids[0] == std::vector<std::string>{"s0", "s1", "s3", "s3"});
    CHECK(ids[1] == std::vector<std::string>{"s4", "s5", "s8", "s8"});
    if (reference.empty()) reference = ids;
    CHECK(ids == reference);
  }
  // From the middle on as from the start.
  Loader resumed(set, options, {1, 1});
  const auto rest = all_ids(resumed);
  CHECK(std::equal(rest.begin(), rest.end(), reference.begin() + 4, reference.end()));

  Loader hopeless(std::make_shared<CountedSet>(3, std::set<int64_t>{0, 1, 2}), options);
  CHECK(contains(message_of([&] { hopeless.next(); }), "none of 3 scenes can be used"));
}

TEST_CASE("the sensor's draws depend on epoch and scene, not on threads or place", "[loader]") {
  const auto set = std::make_shared<CountedSet>(8);
  LoaderOptions options = small_options();
  options.capture.exposure = {0.25, 4.0};
  options.capture.sensor.on = true;
  options.cache_bytes = 1 << 24;  // scenes stay clean in the cache
  const auto seen = [&](int threads, LoaderPosition start) {
    options.threads = threads;
    Loader loader(set, options, start);
    std::map<std::pair<int64_t, std::string>, double> values;
    while (const std::optional<Batch> batch = loader.next()) {
      const int64_t size = batch->input.numel() / batch->size();
      for (int64_t i = 0; i < batch->size(); ++i) {
        values[{batch->epoch, batch->ids[static_cast<size_t>(i)]}] = batch->input.at(i * size);
      }
    }
    return values;
  };
  const auto all = seen(1, {});
  REQUIRE(all.size() == 24);
  CHECK(seen(3, {}) == all);
  for (const auto& [key, value] : seen(2, {1, 1})) CHECK(all.at(key) == value);
  CHECK(all.at({0, "s5"}) != all.at({1, "s5"}));
  options.seed = 6;
  CHECK(seen(1, {}).at({0, "s5"}) != all.at({0, "s5"}));
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

TEST_CASE("memory does not grow with the set", "[loader]") {
  // Many lines that name one file: what a large set costs without its disk space.
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0);
  const SceneRecord record = read_scene_index(folder / "train.jsonl").front();
  const auto write_lines = [&](int64_t count) {
    std::string text;
    SceneRecord line = record;
    for (int64_t i = 0; i < count; ++i) {
      line.id = std::to_string(i);
      text += to_json_line(line) + "\n";
    }
    write_file_atomically(folder / "train.jsonl", std::string_view(text));
  };
  constexpr int64_t kScenes = 5000;
  std::array<int64_t, 2> held{};
  std::array<int64_t, 2> pool{};
  for (const size_t large : {0U, 1U}) {
    write_lines(large == 1 ? kScenes : 50);
    tensor_pool().release_cached();
    tensor_pool().reset_peak();
    const int64_t before = heap_bytes();
    const std::shared_ptr<const Dataset> set = open_dataset(folder.path());
    LoaderOptions options;
    options.batch = 4;
    options.threads = 2;
    options.encode.inputs = {InputKind::kMask};  // small batches: how many are ready at the end is chance
    options.wanted = {.targets = false, .reconstruction = false};
    Loader loader(set, options);
    for (int i = 0; i < 30; ++i) loader.next();
    held[large] = heap_bytes() - before;
    pool[large] = tensor_pool().peak_bytes();
  }
  // 8 bytes of the index and 8 of each epoch's order that is in use; scenes in flight are beside the point.
  CHECK(held[1] - held[0] <= kScenes * 40 + (1 << 20));
  const int64_t sample_bytes = 32 * 32 * (1 + 1) * 4 + 1024;
  for (const int64_t bytes : pool) CHECK(bytes <= (options_prefetch() + 1) * 4 * sample_bytes);
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

bool same_values(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() && std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
}

TEST_CASE("with a support a batch holds what the whole one has there, to the last bit", "[loader]") {
  const TempFolder folder;
  write_small_set(folder.path(), 5, 0, 96, 0.3F);
  const std::shared_ptr<const Dataset> set = open_dataset(folder.path());
  const bool release = GENERATE(false, true);
  const bool sensor = GENERATE(false, true);
  const int64_t dilation = GENERATE(0, 1);
  LoaderOptions options;
  options.batch = 3;
  options.min_last = 1;
  options.epochs = 2;
  options.encode = release ? EncodeOptions::release() : EncodeOptions::paper();
  options.capture.sensor.on = sensor;
  Loader whole_loader(set, options);
  options.wanted.support = dilation;
  options.threads = 2;
  options.cache_bytes = 1 << 24;
  Loader loader(set, options);
  int64_t batches = 0;
  while (const std::optional<Batch> whole = whole_loader.next()) {
    const std::optional<Batch> part = loader.next();
    REQUIRE(part);
    const auto sites = support_of(whole->mask, dilation);
    REQUIRE(sites->count() < whole->mask.numel());
    CHECK(part->ids == whole->ids);
    for (Tensor Batch::*field :
         {&Batch::normal, &Batch::depth, &Batch::mask, &Batch::bsdf, &Batch::polarised}) {
      REQUIRE((*part.*field).sites());
      CHECK(*(*part.*field).sites() == *sites);
      CHECK(same_values(*part.*field, select_sites(*whole.*field, sites)));
    }
    for (Tensor Batch::*field : {&Batch::input, &Batch::illumination, &Batch::sss}) {
      CHECK(same_values(*part.*field, *whole.*field));
    }
    ++batches;
  }
  CHECK(batches == 4);
  CHECK_FALSE(loader.next());
}

TEST_CASE("of a support only its box is kept, and no less", "[loader]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0, 96, 0.3F);
  const auto set = open_dataset(folder.path());
  const SceneRecord record = read_scene_index(folder / "train.jsonl").front();
  const LoadOptions options{.whole = false, .support = 0};
  Scene scene = set->load(Split::kTrain, 0, options);
  REQUIRE(scene.object);
  CHECK(scene.window == scene.object);
  CHECK(scene.object->contains(record.box));
  CHECK(scene.object->pixels() < 96 * 96);
  CHECK(scene.byte_size() < set->load(Split::kTrain, 0).byte_size());
  CHECK(set->load(Split::kTrain, 0, {.support = 6}).object == Window{0, 0, 96, 96});

  const EncodeWanted wanted{.support = 0};
  BatchBuilder(1, EncodeOptions::paper(), wanted).add(scene);
  // Nothing else may be asked of it: neither other tiles nor the whole image.
  BatchBuilder wider(1, EncodeOptions::paper(), {.support = 3});
  CHECK(contains(message_of([&] { wider.add(scene); }), "outside what was read"));
  CHECK(contains(message_of([&] { encode_scene(scene, EncodeOptions::paper()); }), "outside what was read"));
  scene.normal.pop_back();
  BatchBuilder builder(1, EncodeOptions::paper(), wanted);
  CHECK(contains(message_of([&] { builder.add(scene); }), "normal"));
}

TEST_CASE("scenes of two sizes share no batch, with a support or without", "[loader]") {
  const TempFolder small, large;
  write_small_set(small.path(), 1, 0, 64);
  write_small_set(large.path(), 1, 0, 96);
  for (const std::optional<int64_t> support : {std::optional<int64_t>(), std::optional<int64_t>(0)}) {
    BatchBuilder builder(2, EncodeOptions::paper(), {.support = support});
    builder.add(open_dataset(small.path())->load(Split::kTrain, 0));
    CHECK(contains(message_of([&] { builder.add(open_dataset(large.path())->load(Split::kTrain, 0)); }),
                   "scenes of a batch need one size"));
  }
}

}  // namespace
}  // namespace opaline::test
