/* What both versions of FMI share: an instance, and its variables by reference. */

#include <stdlib.h>
#include <string.h>

#include "rid.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { CONTROL = 0, OUTPUT = 1000, STATE = 2000, FROM = 3000, SLOPE = 4000, STEP_SIZE = 5000, HOLD, SETTLE, TIME, THETA_AT = 10000 };

typedef struct {
  rid_model m;
  double slope[RID_NU];
  int begun, stale, changed; /* outputs or parameters are not up to date */
} instance;

static int inside(unsigned reference, int first, int count) {
  return (int)reference >= first && (int)reference < first + count;
}

static void fresh(instance* s) {
  memset(s, 0, sizeof *s);
  rid_defaults(&s->m);
}

static void begin(instance* s, double t) {
  rid_begin(&s->m, t);
  s->begun = 1;
  s->stale = s->changed = 0;
}

static void up_to_date(instance* s) {
  if (!s->begun) return;
  if (s->changed) rid_prepare(&s->m);
  if (s->stale || s->changed) rid_refresh(&s->m);
  s->stale = s->changed = 0;
}

static int get_number(instance* s, unsigned r, double* value) {
  if (inside(r, OUTPUT, RID_NY) || inside(r, STATE, RID_NX)) {
    if (!s->begun) begin(s, s->m.t), s->begun = 0;
    up_to_date(s);
  }
  if (inside(r, CONTROL, RID_NU)) *value = s->m.u[r - CONTROL];
  else if (inside(r, OUTPUT, RID_NY)) *value = s->m.y[r - OUTPUT];
  else if (inside(r, STATE, RID_NX)) *value = s->m.x[r - STATE];
  else if (inside(r, FROM, RID_NX)) *value = s->m.start[r - FROM];
  else if (inside(r, SLOPE, RID_NU)) *value = s->slope[r - SLOPE];
  else if (inside(r, THETA_AT, RID_NP)) *value = s->m.theta[r - THETA_AT];
  else if (r == STEP_SIZE) *value = s->m.step;
  else if (r == TIME) *value = s->m.t;
  else return 0;
  return 1;
}

static int set_number(instance* s, unsigned r, double value) {
  if (inside(r, CONTROL, RID_NU)) s->m.u[r - CONTROL] = value, s->stale = 1;
  else if (inside(r, SLOPE, RID_NU)) s->slope[r - SLOPE] = value;
  else if (inside(r, FROM, RID_NX)) s->m.start[r - FROM] = value, s->stale = 1;
  else if (inside(r, THETA_AT, RID_NP)) s->m.theta[r - THETA_AT] = value, s->changed = 1;
  else if (r == STEP_SIZE && value > 0.0) s->m.step = value;
  else return 0;
  return 1;
}

static int* switch_of(instance* s, unsigned r) { return r == HOLD ? &s->m.hold : r == SETTLE ? &s->m.settle : NULL; }

static void advance(instance* s, double seconds) {
  double u[RID_NU];
  int i;
  up_to_date(s);
  for (i = 0; i < RID_NU; i++) u[i] = s->m.u[i] + s->slope[i] * seconds;
  rid_step(&s->m, u, seconds);
}

static int finite_states(const instance* s) {
  int i;
  for (i = 0; i < RID_NX; i++)
    if (!(s->m.x[i] - s->m.x[i] == 0.0)) return 0;
  return 1;
}

/* Saved states: the same in both versions but for the names, `Saved` and `Restored` of FMUstate and DeSerialize. */
enum { DONE, FAILED = 3 };

static int copied(void** state, const void* from) {
  if (!*state) *state = malloc(sizeof(instance));
  if (!*state) return FAILED;
  memcpy(*state, from, sizeof(instance));
  return DONE;
}

#define SAVED_STATES(fmi, Saved, Restored, byte)                                                       \
  EXPORT int fmi##Get##Saved(instance* s, void** state) { return copied(state, s); }                   \
  EXPORT int fmi##Set##Saved(instance* s, void* state) { memcpy(s, state, sizeof *s); return DONE; }   \
  EXPORT int fmi##Free##Saved(instance* s, void** state) {                                             \
    (void)s;                                                                                           \
    free(*state);                                                                                      \
    *state = NULL;                                                                                     \
    return DONE;                                                                                       \
  }                                                                                                    \
  EXPORT int fmi##Serialized##Saved##Size(instance* s, void* state, size_t* size) {                    \
    (void)state;                                                                                       \
    *size = sizeof *s;                                                                                 \
    return DONE;                                                                                       \
  }                                                                                                    \
  EXPORT int fmi##Serialize##Saved(instance* s, void* state, byte bytes[], size_t size) {              \
    if (size < sizeof *s) return FAILED;                                                               \
    memcpy(bytes, state, sizeof *s);                                                                   \
    return DONE;                                                                                       \
  }                                                                                                    \
  EXPORT int fmi##Restored##Saved(instance* s, const byte bytes[], size_t size, void** state) {        \
    return size < sizeof *s ? FAILED : copied(state, bytes);                                           \
  }
