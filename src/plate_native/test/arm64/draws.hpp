// Random inputs that are equal on all processors, and results as bytes on the standard output.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <plate/view.hpp>

using plate::View;
using Numbers = std::vector<double>;

// SplitMix64: integers only, so that it has one sequence everywhere.
struct Draws {
    std::uint64_t state;

    explicit Draws(std::uint64_t seed) : state(seed) {}

    std::uint64_t next() {
        std::uint64_t z = (state += 0x9e3779b97f4a7c15);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
        z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
        return z ^ (z >> 31);
    }
    double in(double low, double high) { return low + (high - low) * (next() >> 11) * 0x1p-53; }
    int below(int count) { return static_cast<int>(next() % count); }
    Numbers many(int count, double low, double high) {
        Numbers numbers(count);
        for (double& number : numbers) number = in(low, high);
        return numbers;
    }
};

// Steps (n,) of `low` to `high` [s].
inline Numbers rising(Draws& draws, int count, double low, double high) {
    Numbers times(count + 1);
    for (int k = 0; k < count; k++) times[k + 1] = times[k] + draws.in(low, high);
    return times;
}

template <class T, int N>
View<T, N> shaped(std::vector<T>& numbers, std::array<int, N> shape) {
    return {numbers.data(), shape};
}
template <int N>
View<const double, N> given(const Numbers& numbers, std::array<int, N> shape) {
    return {numbers.data(), shape};
}

inline void put(const double* numbers, std::size_t count) {
    std::fwrite(numbers, sizeof(double), count, stdout);
}
inline void put(const Numbers& numbers) { put(numbers.data(), numbers.size()); }
inline void put(double number) { put(&number, 1); }

// Calls `draw` as often as the first word of the command line says, each time with other numbers.
template <class Draw>
int repeat(char** words, Draw draw) {
    for (int k = 0; k < std::atoi(words[1]); k++) {
        Draws draws(k);
        draw(draws);
    }
    return 0;
}
