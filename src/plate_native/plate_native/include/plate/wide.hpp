// Functions whose loops run on vectors: compiled for several widths, chosen when they are loaded.
//
// What they return is the same: no sum changes its order, no product is fused with a sum. Not for 512
// bits: there GCC 12 loads past the ends of arrays (test_native.py).
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define PLATE_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define PLATE_WIDE
#endif
