/* As many rows at a time as a vector of AVX2 has lanes. AVX-512 has twice as many, for a third less time; but then the
 * clock of all else the core does falls by a tenth, which costs more. */
#include "learn.h"

#if MANY > 1
#define LANES MANY
#define TARGET __attribute__((target("avx2")))
#define STEP step_many
#include "rows.h"
#endif
