// Checkpoints: what is written comes back, and damage is found.
#include "train/checkpoint.h"

#include <catch2/catch.hpp>
#include <fstream>

#include "core/error.h"
#include "core/file.h"
#include "tests/train/synthetic.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;
using Catch::Matchers::Contains;

Cascade small_cascade(uint64_t seed) {
  Cascade cascade({.network = {.variant = Variant::kPaper, .input_channels = 4, .image_size = 32, .width = 4},
                   .stage = 1});
  cascade.initialize(seed);
  return cascade;
}

TrainingState state_at(int64_t step) {
  TrainingState state;
  state.step = step;
  state.epoch = 2;
  state.batch = 3;
  state.stage_step = step;
  state.log_lines = 17;
  state.epoch_sums = {{"total", 0.1 + 0.2}, {"images", 24.0}};
  state.config = "[train]\nseed = 1\n";
  state.data = "0123456789abcdef";
  return state;
}

void flip_bit(const fs::path& path, int64_t at) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(at);
  const char byte = static_cast<char>(file.get());
  file.seekp(at);
  file.put(static_cast<char>(byte ^ 4));
}

const Warn kIgnore = [](std::string_view) {};

TEST_CASE("a checkpoint comes back bit by bit") {
  const test::TemporaryFolder folder("checkpoint");
  const Cascade cascade = small_cascade(1);
  const Adam adam(cascade.named_parameters());
  const fs::path written = save_checkpoint(folder.path(), state_at(5), cascade, adam);
  CHECK(written.filename() == "step-5");
  for (const char* const name : {"normal.safetensors", "depth.safetensors", "illumination.safetensors",
                                 "optimizer.safetensors", "state.json"}) {
    CHECK(fs::exists(written / name));
  }
  const Checkpoint loaded = load_checkpoint(written);
  CHECK(loaded.state.step == 5);
  CHECK(loaded.state.epoch == 2);
  CHECK(loaded.state.batch == 3);
  CHECK(loaded.state.log_lines == 17);
  CHECK(loaded.state.epoch_sums.at("total") == 0.1 + 0.2);
  CHECK(loaded.state.config == state_at(5).config);
  CHECK(loaded.state.data == state_at(5).data);
  Cascade other = small_cascade(2);
  restore_networks(loaded, other);
  for (const std::string& name : cascade.network_names()) {
    for (const auto& [key, tensor] : cascade.network(name).state_dict()) {
      const Tensor back = other.network(name).state_dict().at(key);
      CHECK(std::equal(tensor.bytes(), tensor.bytes() + tensor.byte_size(), back.bytes()));
    }
  }
  CHECK(load_checkpoint(written, {.networks = {"depth"}, .optimizer = false}).networks.size() == 1);
}

TEST_CASE("a damaged checkpoint is passed over with a warning") {
  const std::string file = GENERATE("normal.safetensors", "optimizer.safetensors", "state.json");
  const bool truncated = GENERATE(false, true);
  const test::TemporaryFolder folder("damage");
  const Cascade cascade = small_cascade(1);
  const Adam adam(cascade.named_parameters());
  save_checkpoint(folder.path(), state_at(5), cascade, adam);
  const fs::path damaged = save_checkpoint(folder.path(), state_at(10), cascade, adam) / file;
  const auto size = static_cast<int64_t>(fs::file_size(damaged));
  if (truncated) {
    fs::resize_file(damaged, static_cast<uintmax_t>(size / 2));
  } else {
    flip_bit(damaged, size / 2);
  }
  CHECK_THROWS_AS(load_checkpoint(damaged.parent_path()), Error);
  std::string warning;
  const Checkpoint loaded =
      load_newest_checkpoint(folder.path(), [&](std::string_view line) { warning += line; });
  CHECK(loaded.state.step == 5);
  CHECK_THAT(warning, Contains("step-10") && Contains(file));
}

TEST_CASE("a file of another checkpoint is not taken for this one's") {
  const test::TemporaryFolder folder("mixed");
  const Cascade first = small_cascade(1);
  const Cascade second = small_cascade(2);
  const fs::path a = save_checkpoint(folder.path(), state_at(5), first, Adam(first.named_parameters()));
  const fs::path b = save_checkpoint(folder.path(), state_at(10), second, Adam(second.named_parameters()));
  fs::copy_file(a / "depth.safetensors", b / "depth.safetensors", fs::copy_options::overwrite_existing);
  CHECK_THROWS_WITH(load_checkpoint(b), Contains("depth.safetensors") && Contains("checksum"));
}

TEST_CASE("every bit of a checkpoint's state is guarded") {
  const test::TemporaryFolder folder("state");
  const Cascade cascade = small_cascade(1);
  const fs::path path =
      save_checkpoint(folder.path(), state_at(5), cascade, Adam(cascade.named_parameters()));
  const std::string whole = read_text(path / "state.json");
  for (size_t at = 0; at < whole.size(); at += 3) {
    std::string text = whole;
    text[at] = static_cast<char>(text[at] ^ 1);
    write_file_atomically(path / "state.json", std::string_view(text));
    INFO("byte " << at << " of\n" << text);
    CHECK_THROWS_AS(load_checkpoint(path, {.networks = {"depth"}, .optimizer = false}), Error);
  }
}

TEST_CASE("the last k are kept, half-written ones are removed") {
  const test::TemporaryFolder folder("prune");
  const Cascade cascade = small_cascade(1);
  const Adam adam(cascade.named_parameters());
  for (const int64_t step : {9, 10, 11, 100}) save_checkpoint(folder.path(), state_at(step), cascade, adam);
  fs::create_directories(folder.path() / ".tmp-step-101.1");
  fs::create_directories(folder.path() / "step-notes");
  prune_checkpoints(folder.path(), 2);
  const auto left = list_checkpoints(folder.path());
  REQUIRE(left.size() == 2);
  CHECK(left[0].filename() == "step-100");
  CHECK(left[1].filename() == "step-11");
  CHECK_FALSE(fs::exists(folder.path() / ".tmp-step-101.1"));
  CHECK(fs::exists(folder.path() / "step-notes"));
}

TEST_CASE("networks that do not fit are refused with the whole difference") {
  const test::TemporaryFolder folder("misfit");
  const Cascade small = small_cascade(1);
  const Checkpoint loaded =
      load_checkpoint(save_checkpoint(folder.path(), state_at(5), small, Adam(small.named_parameters())));
  Cascade wide({.network = {.variant = Variant::kPaper, .input_channels = 4, .image_size = 32, .width = 8},
                .stage = 1});
  CHECK_THROWS_WITH(restore_networks(loaded, wide),
                    Contains("depth.safetensors") &&
                        Contains("inc.double_conv.0.weight is 4x4x3x3, expected 8x4x3x3") &&
                        Contains("outc.conv.weight"));
  Checkpoint renamed = loaded;
  renamed.networks.at("depth")["inc.double_conv.9.weight"] =
      renamed.networks.at("depth").at("inc.double_conv.0.weight");
  renamed.networks.at("depth").erase("inc.double_conv.0.weight");
  Cascade again = small_cascade(2);
  CHECK_THROWS_WITH(restore_networks(renamed, again),
                    Contains("missing: inc.double_conv.0.weight") && Contains("inc.double_conv.9.weight"));
}

TEST_CASE("writing the same step again replaces it") {
  const test::TemporaryFolder folder("again");
  const Cascade first = small_cascade(1);
  save_checkpoint(folder.path(), state_at(5), first, Adam(first.named_parameters()));
  const Cascade second = small_cascade(2);
  TrainingState state = state_at(5);
  state.epoch = 9;
  save_checkpoint(folder.path(), state, second, Adam(second.named_parameters()));
  CHECK(load_newest_checkpoint(folder.path(), kIgnore).state.epoch == 9);
  CHECK(list_checkpoints(folder.path()).size() == 1);
}

TEST_CASE("a checkpoint that cannot be written is loud and leaves the old ones") {
  const test::TemporaryFolder folder("nowhere");
  const Cascade cascade = small_cascade(1);
  const Adam adam(cascade.named_parameters());
  write_file_atomically(folder.path() / "file", std::string_view("not a folder"));
  CHECK_THROWS_WITH(save_checkpoint(folder.path() / "file", state_at(5), cascade, adam), Contains("file"));
  CHECK_THROWS_WITH(load_newest_checkpoint(folder.path(), kIgnore), Contains("no checkpoint"));
}

}  // namespace
}  // namespace opaline
