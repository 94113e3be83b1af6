// Eight numbers of single precision that are reckoned with at once: + - * / work on each of them.
#pragma once
#include <cstring>

namespace plate {

using Eight = float __attribute__((vector_size(8 * sizeof(float))));

[[gnu::always_inline]] inline void load(Eight& eight, const float* from) { std::memcpy(&eight, from, sizeof eight); }
[[gnu::always_inline]] inline void store(const Eight& eight, float* to) { std::memcpy(to, &eight, sizeof eight); }

}  // namespace plate
