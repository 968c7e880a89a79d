#include "data/toml_config.h"

#include "tests/data/support.h"

namespace opaline::test {
namespace {

TEST_CASE("config values come with defaults and overrides", "[toml]") {
  const std::vector<std::string> overrides = {"train.rate=0.5", "name=bare word", "train.layers=[1, 2]"};
  TomlConfig config = TomlConfig::from_text(
      "name = \"a\"\n[train]\nepochs = 3\nrate = 1\nshuffle = false\ninputs = [\"pol4\", \"mask\"]\n",
      "c.toml", overrides);
  const TomlTable root = config.root();
  CHECK(root.text("name", "") == "bare word");
  const TomlTable train = root.table("train");
  CHECK(train.integer("epochs", 20, {.min = 1}) == 3);
  CHECK(train.real("rate", 2e-4) == 0.5);
  CHECK(train.real("decay", 0.25) == 0.25);
  CHECK_FALSE(train.boolean("shuffle", true));
  CHECK(train.texts("inputs", {}) == std::vector<std::string>{"pol4", "mask"});
  CHECK(train.reals("layers", {}) == std::vector<double>{1, 2});
  CHECK(train.has("epochs"));
  CHECK_FALSE(train.has("decay"));
  CHECK(root.table("absent").integer("x", 5) == 5);
  config.finish();
}

TEST_CASE("the resolved config reads as the same config", "[toml]") {
  const auto read = [](TomlConfig& config) {
    const TomlTable table = config.root().table("a").table("b");
    return std::tuple(table.integer("i", 4), table.real("r", 1e-9), table.text("t", "x \"y\"\n"),
                      table.boolean("o", true), table.reals("v", {1, 0.5}), table.texts("w", {"p"}));
  };
  TomlConfig first = TomlConfig::from_text("[a.b]\ni = 7\n", "c.toml");
  const auto values = read(first);
  TomlConfig second = TomlConfig::from_text(first.resolved(), "resolved.toml");
  CHECK(read(second) == values);
  second.finish();
  CHECK(second.resolved() == first.resolved());
}

TEST_CASE("all problems of a config come at once, with file and line", "[toml]") {
  const std::vector<std::string> overrides = {"train.epochss=3"};
  TomlConfig config = TomlConfig::from_text(
      "[train]\n"
      "epochs = 0\n"
      "lerning_rate = 1.0\n"
      "batch = \"many\"\n"
      "weight = nan\n"
      "mode = \"papr\"\n"
      "[trian]\n"
      "x = 1\n",
      "c.toml", overrides);
  const TomlTable train = config.root().table("train");
  train.integer("epochs", 20, {.min = 1});
  train.real("learning_rate", 1);
  train.integer("batch", 16);
  train.real("weight", 1);
  constexpr std::array<std::string_view, 2> kModes = {"paper", "release"};
  CHECK(train.choice("mode", "paper", kModes) == "paper");
  train.require("seed");
  const std::string message = message_of([&] { config.finish(); });
  INFO(message);
  CHECK(contains(message, "c.toml:2: 'train.epochs' is 0; it must be at least 1"));
  CHECK(contains(message, "c.toml:3: unknown key 'train.lerning_rate'; did you mean 'train.learning_rate'?"));
  CHECK(contains(message, "c.toml:4: 'train.batch' must be an integer, not a string"));
  CHECK(contains(message, "c.toml:5: 'train.weight' is nan"));
  CHECK(contains(message,
                 "c.toml:6: 'train.mode': 'papr' is not one of: paper, release; did you mean 'paper'?"));
  CHECK(contains(message, "c.toml:7: unknown key 'trian'; did you mean 'train'?"));
  CHECK(contains(message, "'train.seed': is missing"));
  CHECK(
      contains(message, "--set train.epochss=3: unknown key 'train.epochss'; did you mean 'train.epochs'?"));
  CHECK_THROWS_AS(config.finish(), UsageError);
}

TEST_CASE("text that is not TOML is refused with its line", "[toml]") {
  CHECK(contains(message_of([] { TomlConfig::from_text("a = 1\nb = = 2\n", "c.toml"); }), "c.toml:2"));
  CHECK_THROWS_AS(TomlConfig::from_file("/no/such/file.toml"), UsageError);
  const std::vector<std::string> bad = {"novalue"};
  CHECK_THROWS_AS(TomlConfig::from_text("", "c.toml", bad), UsageError);
}

TEST_CASE("suggestions are near or absent", "[toml]") {
  const std::vector<std::string> keys = {"epochs", "batch", "rate"};
  CHECK(did_you_mean("epcohs", keys) == "epochs");
  CHECK(did_you_mean("bach", keys) == "batch");
  CHECK(did_you_mean("illumination", keys).empty());
  CHECK(did_you_mean("xy", keys).empty());
}

TEST_CASE("damaged configs are parsed or refused, never more", "[toml][fuzz]") {
  const std::string text = "[a]\nx = 1\ny = [1.5, 2]\nz = \"t\"\n[a.b]\nd = 1979-05-27\ni = { p = 1 }\n";
  const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
  const int refused =
      parse_mutations({bytes.begin(), bytes.end()}, 10000, 24, [](std::span<const std::byte> mutated) {
        const std::string_view view(reinterpret_cast<const char*>(mutated.data()), mutated.size());
        TomlConfig config = TomlConfig::from_text(view, "c.toml");
        const TomlTable a = config.root().table("a");
        a.integer("x", 0);
        a.reals("y", {});
        a.text("z", "");
        a.table("b").text("d", "");
        config.finish();
      });
  CHECK(refused > 5000);
}

}  // namespace
}  // namespace opaline::test
