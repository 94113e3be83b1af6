// Four numbers that are reckoned with at once: + - * / work on each of them.
#pragma once
#include <cstring>

namespace plate {

using Four = double __attribute__((vector_size(4 * sizeof(double))));

[[gnu::always_inline]] inline void load(Four& four, const double* from) { std::memcpy(&four, from, sizeof four); }
[[gnu::always_inline]] inline void store(const Four& four, double* to) { std::memcpy(to, &four, sizeof four); }

}  // namespace plate
