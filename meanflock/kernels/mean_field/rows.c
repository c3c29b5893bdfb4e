/* The step of as many rows at a time as a vector of AVX2 has lanes. */
#include "learn.h"

#if MANY > 1
#define LANES MANY
#define TARGET __attribute__((target("avx2")))
#define STEP step_many
#include "rows.h"
#endif
