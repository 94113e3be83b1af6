// The macro PLATE_WIDE compiles a function for several vector widths. At program start, the loader
// of the operating system selects the version for the processor.
//
// The results do not depend on the vector width. The order of the terms in sums is fixed, and no
// instruction combines a product and a sum. Therefore the processor features of the wide version do
// not include FMA: with FMA, GCC 12 can combine them (vfmaddsub) in spite of -ffp-contract=off.
// Vectors of 512 bits are also excluded. For such vectors, GCC 12 generates code that reads beyond
// the ends of arrays (test_native.py).
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define PLATE_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define PLATE_WIDE
#endif
