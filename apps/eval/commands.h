#pragma once

namespace CLI {
class App;
}

namespace iclk {

void add_bench(CLI::App& app, int& exit);
void add_eval(CLI::App& app, int& exit);
void add_flight_eval(CLI::App& app, int& exit);
void add_locate_eval(CLI::App& app, int& exit);

}  // namespace iclk
