// View of an array, which does not own its memory, and matrix, which owns its memory. In both, the
// numbers of a row are consecutive in memory.
#pragma once
#include <array>
#include <cstddef>
#include <new>
#include <vector>

namespace plate {

// View of an array with N axes. The entries along the last axis are consecutive in memory.
template <class T, int N>
struct View {
    T* data;
    std::array<int, N> shape;

    int size(int axis) const { return shape[axis]; }

    template <class... Index>
    T& operator()(Index... index) const {
        static_assert(sizeof...(Index) == N);
        const int at[] = {static_cast<int>(index)...};
        int offset = at[0];
        for (int axis = 1; axis < N; axis++) offset = offset * shape[axis] + at[axis];
        return data[offset];
    }

    // Returns a pointer to the entries at an index of the first axis.
    T* operator[](int index) const {
        int each = 1;
        for (int axis = 1; axis < N; axis++) each *= shape[axis];
        return data + index * each;
    }
};

// Allocator whose memory is aligned to cache lines, so that no vector register is loaded from two
// lines.
template <class T>
struct Aligned {
    using value_type = T;
    static constexpr std::align_val_t LINE{64};

    Aligned() = default;
    template <class Other>
    Aligned(const Aligned<Other>&) {}
    T* allocate(size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), LINE)); }
    void deallocate(T* memory, size_t) { ::operator delete(memory, LINE); }
    bool operator==(const Aligned&) const { return true; }
};

template <class Number>
using AlignedNumbers = std::vector<Number, Aligned<Number>>;

// A matrix that owns its numbers. If the matrix becomes smaller, it keeps its memory.
template <class Number>
struct MatrixOf {
    int rows = 0, columns = 0;
    AlignedNumbers<Number> numbers;

    MatrixOf() = default;
    MatrixOf(int r, int c) { resize(r, c); }

    void resize(int r, int c) {
        rows = r, columns = c;
        if (numbers.size() < static_cast<size_t>(r) * c) numbers.resize(static_cast<size_t>(r) * c);
    }
    Number* operator[](int row) { return numbers.data() + row * columns; }
    const Number* operator[](int row) const { return numbers.data() + row * columns; }
};

using Matrix = MatrixOf<double>;

// View of samples of a motion: three numbers per instant, which are x, y and theta of a pose or
// twist. `by_sample` and `by_axis` are the distances in memory between samples and between axes.
template <class Number>
struct SamplesOf {
    const Number* data;
    int count, by_sample, by_axis;

    Number operator()(int sample, int axis) const { return data[sample * by_sample + axis * by_axis]; }
};

using Samples = SamplesOf<double>;

}  // namespace plate
