/* NumPy's order of summation, for compiled code that gives NumPy's bits.
 *
 * The including file defines the number LANES of lanes of a vector, and for more than one lane the TARGET.
 */
#ifndef MEANFLOCK_PAIRWISE_H
#define MEANFLOCK_PAIRWISE_H

#include <stddef.h>

#if LANES > 1
#define INLINE static inline __attribute__((always_inline)) TARGET
typedef double Lanes __attribute__((vector_size(LANES * sizeof(double))));
#else
#define INLINE static inline
typedef double Lanes;
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define TARGET __attribute__((target_clones("default", "avx2"))) /* wider vectors, the same operations */
#define WIDE_TARGET __attribute__((target_clones("default", "avx2", "avx512f"))) /* of kernels for large swarms only */
#else
#define TARGET
#define WIDE_TARGET
#endif
#endif

enum { PAIRWISE = 128 }; /* numbers that NumPy sums in one block */

/* NumPy's pairwise sum of a[i] b[i], or of a[i] if b is NULL; n: 1 … PAIRWISE. */
INLINE Lanes pairwise(const Lanes *a, const Lanes *b, int n) {
#define ITEM(i) (b != NULL ? a[i] * b[i] : a[i])
    if (n < 8) {
        Lanes sum = ITEM(0);
        for (int i = 1; i < n; i++) sum += ITEM(i);
        return sum;
    }
    Lanes r[8];
    int i = 8;
    for (int k = 0; k < 8; k++) r[k] = ITEM(k);
    for (; i < n - n % 8; i += 8)
        for (int k = 0; k < 8; k++) r[k] += ITEM(i + k);
    Lanes sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
    for (; i < n; i++) sum += ITEM(i);
    return sum;
#undef ITEM
}

#if LANES == 1
/* The same sum of any number of terms, at least one. */
static inline double sum_of(const double *a, ptrdiff_t n) {
    if (n <= PAIRWISE) return pairwise(a, NULL, (int)n);
    ptrdiff_t half = n / 2 - n / 2 % 8;
    return sum_of(a, half) + sum_of(a + half, n - half);
}
#endif

#endif
