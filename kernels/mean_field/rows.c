/* The step of as many rows at a time as a vector of AVX2 has lanes. AVX-512 has twice as many and takes a third less time,
 * but it lowers the clock of the core by a tenth, which costs more. */
#include "learn.h"

#if MANY > 1
#define LANES MANY
#define TARGET __attribute__((target("avx2")))
#define STEP step_many
#include "rows.h"
#endif
