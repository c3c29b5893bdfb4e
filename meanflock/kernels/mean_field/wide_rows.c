/* The step of as many rows at a time as a vector of AVX-512 has lanes. */
#include "learn.h"

#if MANY > 1
#define LANES MOST
#define TARGET __attribute__((target("avx512f,avx512dq")))
#define STEP step_most
#include "rows.h"
#endif
