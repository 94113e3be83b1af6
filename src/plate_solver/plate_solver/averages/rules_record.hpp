// Converts the Python tuple `Rules` to the C++ struct, for the bindings.
#pragma once
#include "averages/sinusoid_force.hpp"
#include "records.hpp"

namespace plate {

// Owns the arrays of the Python tuple `Rules` while their views are in use. The constructor checks
// the shapes. `rows` is the total number of sines and cosines of a motion.
class RulesRecord {
public:
    RulesRecord(const nb::tuple& record, size_t rows)
        : waves(field<Table>(record, "waves")), taylor(field<Table>(record, "taylor")) {
        check("waves", waves, {rows, waves.shape(1)});
        check("taylor", taylor, {DEGREE + 1, rows / 2});
        rules = {view(waves), field<int>(record, "few"), view(taylor), field<int>(record, "pieces")};
        const int few = rules.few, usual = rules.waves.size(1) - few;
        if (few < EIGHT || usual < EIGHT || few % EIGHT || usual % EIGHT)
            throw nb::value_error("steps are not a multiple of eight");
        if (rules.pieces < 1) throw nb::value_error("pieces is not at least 1");
    }

    const Rules& operator*() const { return rules; }

private:
    Table waves, taylor;
    Rules rules;
};

}  // namespace plate
