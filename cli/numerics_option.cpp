#include "cli/numerics_option.h"

#include <string>

namespace opaline::cli {

void add_numerics_option(CLI::App& command, Numerics& numerics) {
  command
      .add_option_function<std::string>(
          "--numerics",
          [&numerics](const std::string& text) {
            const auto parsed = parse_numerics(text);
            if (!parsed) throw CLI::ValidationError("--numerics", text + " is not strict, balanced or fast");
            numerics = *parsed;
          },
          "Algorithms by their rounding error: strict, balanced or fast")
      ->default_str(std::string(to_string(numerics)));
}

}  // namespace opaline::cli
