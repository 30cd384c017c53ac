/* FMI 3.0 for co-simulation. Source of the interface: Functional Mock-up Interface 3.0.2, Modelica Association. */

#include <stdbool.h>
#include <stdint.h>

#include "fmu.c"

typedef uint32_t fmi3Reference;
typedef int fmi3Status;
typedef const char* fmi3String;
typedef const uint8_t* fmi3Binary;
typedef instance* fmi3Instance;
typedef void* fmi3Environment;
enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error };

EXPORT const char* fmi3GetVersion(void) { return "3.0"; }
EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance s, bool on, size_t n, const fmi3String categories[]) {
  (void)s, (void)on, (void)n, (void)categories;
  return fmi3OK;
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                                bool logging, bool events, bool early, const fmi3Reference required[],
                                                size_t n, fmi3Environment environment, void* log, void* update) {
  instance* s;
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n;
  (void)environment, (void)log, (void)update;
  if (!token || strcmp(token, RID_GUID)) return NULL;
  s = malloc(sizeof *s);
  if (s) fresh(s);
  return s;
}
EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                                 bool logging, fmi3Environment environment, void* log) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  return NULL;
}
EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      bool visible, bool logging, fmi3Environment environment, void* log,
                                                      void* update, void* lock, void* unlock) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log, (void)update;
  (void)lock, (void)unlock;
  return NULL;
}
EXPORT void fmi3FreeInstance(fmi3Instance s) { free(s); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance s, bool tolerant, double tolerance, double start, bool ends,
                                              double stop) {
  (void)tolerant, (void)tolerance, (void)ends, (void)stop;
  s->m.t = start;
  return fmi3OK;
}
EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance s) { begin(s, s->m.t); return fmi3OK; }
EXPORT fmi3Status fmi3Reset(fmi3Instance s) { fresh(s); return fmi3OK; }

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance s, const fmi3Reference r[], size_t n, double value[], size_t m) {
  size_t k;
  if (m != n) return fmi3Error;
  for (k = 0; k < n; k++) if (!get_number(s, r[k], &value[k])) return fmi3Error;
  return fmi3OK;
}
EXPORT fmi3Status fmi3SetFloat64(fmi3Instance s, const fmi3Reference r[], size_t n, const double value[], size_t m) {
  size_t k;
  if (m != n) return fmi3Error;
  for (k = 0; k < n; k++) if (!set_number(s, r[k], value[k])) return fmi3Error;
  return fmi3OK;
}
EXPORT fmi3Status fmi3GetBoolean(fmi3Instance s, const fmi3Reference r[], size_t n, bool value[], size_t m) {
  size_t k;
  if (m != n) return fmi3Error;
  for (k = 0; k < n; k++) {
    if (!switch_of(s, r[k])) return fmi3Error;
    value[k] = *switch_of(s, r[k]) != 0;
  }
  return fmi3OK;
}
EXPORT fmi3Status fmi3SetBoolean(fmi3Instance s, const fmi3Reference r[], size_t n, const bool value[], size_t m) {
  size_t k;
  up_to_date(s);
  if (m != n) return fmi3Error;
  for (k = 0; k < n; k++) {
    if (!switch_of(s, r[k])) return fmi3Error;
    *switch_of(s, r[k]) = value[k];
    s->stale = 1;
  }
  return fmi3OK;
}

/* Variables of types that the model has not. */
#define NO_VARIABLES(name, type)                                                                                   \
  EXPORT fmi3Status fmi3Get##name(fmi3Instance s, const fmi3Reference r[], size_t n, type value[], size_t m) {       \
    (void)s, (void)r, (void)value, (void)m;                                                                         \
    return n ? fmi3Error : fmi3OK;                                                                                  \
  }                                                                                                                 \
  EXPORT fmi3Status fmi3Set##name(fmi3Instance s, const fmi3Reference r[], size_t n, const type value[], size_t m) { \
    (void)s, (void)r, (void)value, (void)m;                                                                         \
    return n ? fmi3Error : fmi3OK;                                                                                  \
  }
NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(String, fmi3String)

EXPORT fmi3Status fmi3GetBinary(fmi3Instance s, const fmi3Reference r[], size_t n, size_t sizes[], fmi3Binary value[], size_t m) {
  (void)s, (void)r, (void)sizes, (void)value, (void)m;
  return n ? fmi3Error : fmi3OK;
}
EXPORT fmi3Status fmi3SetBinary(fmi3Instance s, const fmi3Reference r[], size_t n, const size_t sizes[], const fmi3Binary value[], size_t m) {
  (void)s, (void)r, (void)sizes, (void)value, (void)m;
  return n ? fmi3Error : fmi3OK;
}
EXPORT fmi3Status fmi3GetClock(fmi3Instance s, const fmi3Reference r[], size_t n, bool value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi3Error : fmi3OK;
}
EXPORT fmi3Status fmi3SetClock(fmi3Instance s, const fmi3Reference r[], size_t n, const bool value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi3Error : fmi3OK;
}

SAVED_STATES(fmi3, FMUState, Deserialize, uint8_t)

EXPORT fmi3Status fmi3DoStep(fmi3Instance s, double t, double h, bool no_way_back, bool* event, bool* terminate,
                             bool* early, double* last) {
  (void)t, (void)no_way_back;
  advance(s, h);
  *event = *terminate = *early = false;
  *last = s->m.t;
  return finite_states(s) ? fmi3OK : fmi3Error;
}
EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance s, const fmi3Reference r[], size_t n, const int32_t orders[], double value[], size_t m) {
  (void)s, (void)r, (void)orders, (void)value, (void)m;
  return n ? fmi3Error : fmi3OK;
}
EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance s, const fmi3Reference r[], size_t n, const fmi3Reference by[], size_t m, const double d[], size_t nd, double out[], size_t no) {
  (void)s, (void)r, (void)n, (void)by, (void)m, (void)d, (void)nd, (void)out, (void)no;
  return fmi3Error;
}
EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance s, const fmi3Reference r[], size_t n, const fmi3Reference by[], size_t m, const double d[], size_t nd, double out[], size_t no) {
  (void)s, (void)r, (void)n, (void)by, (void)m, (void)d, (void)nd, (void)out, (void)no;
  return fmi3Error;
}
EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance s, bool* again, bool* terminate, bool* nominals, bool* states, bool* next, double* time) {
  (void)s, (void)time;
  *again = *terminate = *nominals = *states = *next = false;
  return fmi3OK;
}
EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance s, fmi3Reference r, size_t* n) {
  (void)s, (void)r, (void)n;
  return fmi3Error;
}
EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance s, fmi3Reference r, size_t of[], fmi3Reference by[], size_t at[], int kinds[], size_t n) {
  (void)s, (void)r, (void)of, (void)by, (void)at, (void)kinds, (void)n;
  return fmi3Error;
}

/* Changes of mode, of which the model has none. */
#define MODE(name, answer) \
  EXPORT fmi3Status fmi3##name(fmi3Instance s) { (void)s; return answer; }
MODE(Terminate, fmi3OK)
MODE(EnterStepMode, fmi3OK)
MODE(EnterEventMode, fmi3OK)
MODE(EnterConfigurationMode, fmi3OK)
MODE(ExitConfigurationMode, fmi3OK)
MODE(EvaluateDiscreteStates, fmi3OK)
MODE(EnterContinuousTimeMode, fmi3Error)

/* Clocks, of which the model has none. */
#define CLOCKS(name, type) \
  EXPORT fmi3Status fmi3##name(fmi3Instance s, const fmi3Reference r[], size_t n, type a[]) { (void)s, (void)r, (void)a; return n ? fmi3Error : fmi3OK; }
#define CLOCKS2(name, type, other) \
  EXPORT fmi3Status fmi3##name(fmi3Instance s, const fmi3Reference r[], size_t n, type a[], other b[]) { (void)s, (void)r, (void)a, (void)b; return n ? fmi3Error : fmi3OK; }
CLOCKS2(GetIntervalDecimal, double, int)
CLOCKS(GetShiftDecimal, double)
CLOCKS2(GetShiftFraction, uint64_t, uint64_t)
CLOCKS(SetIntervalDecimal, const double)
CLOCKS2(SetIntervalFraction, const uint64_t, const uint64_t)
CLOCKS(SetShiftDecimal, const double)
CLOCKS2(SetShiftFraction, const uint64_t, const uint64_t)
EXPORT fmi3Status fmi3GetIntervalFraction(fmi3Instance s, const fmi3Reference r[], size_t n, uint64_t a[], uint64_t b[], int c[]) {
  (void)s, (void)r, (void)a, (void)b, (void)c;
  return n ? fmi3Error : fmi3OK;
}
EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance s, fmi3Reference r, double t) {
  (void)s, (void)r, (void)t;
  return fmi3Error;
}

/* Model exchange, which the FMU does not offer. */
EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance s, bool no_way_back, bool* event, bool* terminate) {
  (void)s, (void)no_way_back, (void)event, (void)terminate;
  return fmi3Error;
}
EXPORT fmi3Status fmi3SetTime(fmi3Instance s, double t) { (void)s, (void)t; return fmi3Error; }
EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance s, const double x[], size_t n) { (void)s, (void)x, (void)n; return fmi3Error; }
#define NUMBERS(name) \
  EXPORT fmi3Status fmi3##name(fmi3Instance s, double a[], size_t n) { (void)s, (void)a; return n ? fmi3Error : fmi3OK; }
#define COUNT(name) \
  EXPORT fmi3Status fmi3##name(fmi3Instance s, size_t* n) { (void)s; *n = 0; return fmi3OK; }
NUMBERS(GetContinuousStates)
NUMBERS(GetContinuousStateDerivatives)
NUMBERS(GetNominalsOfContinuousStates)
NUMBERS(GetEventIndicators)
COUNT(GetNumberOfContinuousStates)
COUNT(GetNumberOfEventIndicators)
