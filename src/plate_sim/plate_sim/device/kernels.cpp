// Python binding of the firmware. The firmware is compiled from the same C files as for a real
// board. Only the hardware functions (hal_*) are different, because their inputs and outputs are in
// memory.
#include <plate/bind.hpp>

// These headers are included first, because the firmware's files include them inside a namespace.
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "records.hpp"

namespace plate {
namespace firmware {

#include "firmware/controller.c"
#include "firmware/frame.c"
#include "firmware/motion.c"
#include "firmware/piece.c"
#include "firmware/table.c"
#include "firmware/trigger.c"

namespace {

class Device;
// device that the hal functions use; only the thread with Python's global lock (GIL) may use it
Device* running;

class Device {
public:
    Controller c;
    uint32_t boot;

    Device(nb::handle limits, uint32_t boot, uint64_t now_us) : boot(boot), now_us(now_us) {
        const auto number = [&](const char* name) {
            return static_cast<float>(nb::cast<double>(limits.attr(name)));
        };
        Limits made{number("stroke_m"), number("speed"), number("accel"), number("force"),
                    number("continuous_force"), number("heat_s"), {}, number("following_m")};
        const auto loads = nb::cast<Array<const double, 2>>(limits.attr("load"));
        require(loads.shape(0) == MOTORS && loads.shape(1) == MOTORS, "load: allowed: (4, 4)");
        std::copy_n(loads.data(), MOTORS * MOTORS, made.load[0]);
        running = this;
        controller_start(&c, made);
    }

    nb::tuple tick(uint64_t now, Array<const float, 2> where, nb::bytes data, uint8_t wrong,
                   bool home_found, bool line_idle) {
        require(where.shape(0) == 2 && where.shape(1) == MOTORS, "measured: allowed: (2, 4)");
        now_us = now;
        measured = where.data();
        faults = wrong;
        found = home_found;
        idle = line_idle;
        came.append(data.c_str(), data.size());
        sent.clear();
        commanded.clear();
        running = this;
        controller_tick(&c);
        nb::object at = nb::none();
        if (!commanded.empty()) at = nb::cast(to_numpy<2>(std::move(commanded), {3, MOTORS}));
        return nb::make_tuple(nb::bytes(sent.data(), sent.size()), at);
    }

    void sleep(uint64_t now) { c.now_us = c.received_us = now; }

    bool searches() const { return c.state == STATE_HOMING && c.faults & FAULT_NO_HOME; }

    int room() const { return HAL_INPUT_BYTES - static_cast<int>(came.size()); }

    float hottest() const { return *std::max_element(c.heat, c.heat + MOTORS) / continuous_square(&c); }

    int playing() const { return c.state == STATE_PLAYING ? c.tables[c.playing].id : 0; }

    int waiting() const { return c.waiting ? c.tables[c.next].id : 0; }

    nb::object play() const {
        if (!playing() || c.tables[c.playing].streams) return nb::none();
        return nb::make_tuple(c.playing, c.played, motion_elapsed(&c));
    }

    nb::tuple table() const {
        const Table& table = c.tables[c.playing];
        std::vector<uint32_t> ticks(table.count);
        std::vector<float> states;
        for (int k = 0; k < table.count; k++) {
            const Knot* knot = table_knot(&table, k);
            ticks[k] = knot->ticks;
            for (const float* row : {knot->position, knot->velocity, knot->acceleration})
                states.insert(states.end(), row, row + MOTORS);
        }
        return nb::make_tuple(to_numpy<1, uint32_t>(std::move(ticks), {table.count}),
                              to_numpy<3, float>(std::move(states), {table.count, 3, MOTORS}), table.splice);
    }

    // State of the simulated board.
    uint64_t now_us;
    const float* measured = nullptr;
    uint8_t faults = 0;
    bool found = true, idle = true, high = false;
    std::string came, sent;
    std::vector<float> commanded;
};

}  // namespace

uint64_t hal_time_us(void) { return running->now_us; }
uint32_t hal_boot(void) { return running->boot; }

size_t hal_read(uint8_t* data, size_t size) {
    const size_t count = running->came.copy(reinterpret_cast<char*>(data), size);
    running->came.erase(0, count);
    return count;
}

void hal_write(const uint8_t* data, size_t size) { running->sent.append(data, data + size); }
bool hal_idle(void) { return running->idle; }
void hal_drive(bool) {}
bool hal_ready(void) { return true; }

void hal_command(const float* position, const float* velocity, const float* acceleration) {
    for (const float* row : {position, velocity, acceleration})
        running->commanded.insert(running->commanded.end(), row, row + MOTORS);
}

void hal_measure(float* position, float* acceleration) {
    std::copy_n(running->measured, MOTORS, position);
    std::copy_n(running->measured + MOTORS, MOTORS, acceleration);
}

bool hal_home(void) { return running->found; }
void hal_forget(void) {}
void hal_trigger(bool high) { running->high = high; }
uint8_t hal_faults(void) { return running->faults; }
bool hal_trouble(Trouble*) { return false; }
float hal_load(void) { return 0; }
void hal_watchdog(void) {}

}  // namespace firmware

void bind_device(nb::module_& m) {
    using firmware::Device;
    nb::class_<Device>(m, "Device", "A motor controller: the firmware, on a board in memory.")
        .def(nb::init<nb::handle, uint32_t, uint64_t>(), nb::arg("limits"), nb::arg("boot"),
             nb::arg("now_us") = 0)
        .def("tick", &Device::tick, nb::arg("now_us"), nb::arg("measured"), nb::arg("data"),
             nb::arg("faults") = 0, nb::arg("home_found") = true, nb::arg("line_idle") = true)
        .def("sleep", &Device::sleep)
        .def("table", &Device::table)
        .def_ro("boot", &Device::boot)
        .def_ro("triggered", &Device::high)
        .def_prop_ro("now_us", [](const Device& d) { return d.c.now_us; })
        .def_prop_ro("received_us", [](const Device& d) { return d.c.received_us; })
        .def_prop_ro("enabled_us", [](const Device& d) { return d.c.enabled_us; })
        .def_prop_ro("state", [](const Device& d) { return d.c.state; })
        .def_prop_ro("faults", [](const Device& d) { return d.c.faults; })
        .def_prop_ro("stops", [](const Device& d) { return d.c.stops; })
        .def_prop_ro("refused", [](const Device& d) { return d.c.reader.refused; })
        .def_prop_ro("searches", &Device::searches)
        .def_prop_ro("room", &Device::room)
        .def_prop_ro("hottest", &Device::hottest)
        .def_prop_ro("playing", &Device::playing)
        .def_prop_ro("waiting", &Device::waiting)
        .def_prop_ro("play", &Device::play);
}

}  // namespace plate
