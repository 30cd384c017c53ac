/* FMI 2.0 for co-simulation. Source of the interface: Functional Mock-up Interface 2.0.4, Modelica Association. */

#include "fmu.c"

typedef int fmi2Boolean, fmi2Integer, fmi2Status, fmi2Type;
typedef double fmi2Real;
typedef const char* fmi2String;
typedef unsigned fmi2Reference;
typedef instance* fmi2Component;
typedef void* fmi2Environment;
typedef struct {
  void* log;
  void* (*allocate)(size_t, size_t);
  void (*release)(void*);
  void* finished;
  fmi2Environment environment;
} fmi2Callbacks;
enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error };

EXPORT const char* fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char* fmi2GetVersion(void) { return "2.0"; }
EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component s, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)s, (void)on, (void)n, (void)categories;
  return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2Callbacks* callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  instance* s;
  (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
  if (type != 1 || !guid || strcmp(guid, RID_GUID)) return NULL;
  s = malloc(sizeof *s);
  if (s) fresh(s);
  return s;
}
EXPORT void fmi2FreeInstance(fmi2Component s) { free(s); }

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component s, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean ends, fmi2Real stop) {
  (void)tolerant, (void)tolerance, (void)ends, (void)stop;
  s->m.t = start;
  return fmi2OK;
}
EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component s) { (void)s; return fmi2OK; }
EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component s) { begin(s, s->m.t); return fmi2OK; }
EXPORT fmi2Status fmi2Terminate(fmi2Component s) { (void)s; return fmi2OK; }
EXPORT fmi2Status fmi2Reset(fmi2Component s) { fresh(s); return fmi2OK; }

EXPORT fmi2Status fmi2GetReal(fmi2Component s, const fmi2Reference r[], size_t n, fmi2Real value[]) {
  size_t k;
  for (k = 0; k < n; k++) if (!get_number(s, r[k], &value[k])) return fmi2Error;
  return fmi2OK;
}
EXPORT fmi2Status fmi2SetReal(fmi2Component s, const fmi2Reference r[], size_t n, const fmi2Real value[]) {
  size_t k;
  for (k = 0; k < n; k++) if (!set_number(s, r[k], value[k])) return fmi2Error;
  return fmi2OK;
}
EXPORT fmi2Status fmi2GetBoolean(fmi2Component s, const fmi2Reference r[], size_t n, fmi2Boolean value[]) {
  size_t k;
  for (k = 0; k < n; k++) {
    if (!switch_of(s, r[k])) return fmi2Error;
    value[k] = *switch_of(s, r[k]);
  }
  return fmi2OK;
}
EXPORT fmi2Status fmi2SetBoolean(fmi2Component s, const fmi2Reference r[], size_t n, const fmi2Boolean value[]) {
  size_t k;
  up_to_date(s);
  for (k = 0; k < n; k++) {
    if (!switch_of(s, r[k])) return fmi2Error;
    *switch_of(s, r[k]) = value[k] != 0;
    s->stale = 1;
  }
  return fmi2OK;
}
EXPORT fmi2Status fmi2GetInteger(fmi2Component s, const fmi2Reference r[], size_t n, fmi2Integer value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi2Error : fmi2OK;
}
EXPORT fmi2Status fmi2SetInteger(fmi2Component s, const fmi2Reference r[], size_t n, const fmi2Integer value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi2Error : fmi2OK;
}
EXPORT fmi2Status fmi2GetString(fmi2Component s, const fmi2Reference r[], size_t n, fmi2String value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi2Error : fmi2OK;
}
EXPORT fmi2Status fmi2SetString(fmi2Component s, const fmi2Reference r[], size_t n, const fmi2String value[]) {
  (void)s, (void)r, (void)value;
  return n ? fmi2Error : fmi2OK;
}

SAVED_STATES(fmi2, FMUstate, DeSerialize, char)
EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component s, const fmi2Reference unknown[], size_t n,
                                               const fmi2Reference by[], size_t m, const fmi2Real d[], fmi2Real out[]) {
  (void)s, (void)unknown, (void)n, (void)by, (void)m, (void)d, (void)out;
  return fmi2Error;
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component s, const fmi2Reference r[], size_t n,
                                              const fmi2Integer order[], const fmi2Real value[]) {
  size_t k;
  for (k = 0; k < n; k++) {
    if (!inside(r[k], CONTROL, RID_NU) || order[k] != 1) return fmi2Error;
    s->slope[r[k] - CONTROL] = value[k];
  }
  return fmi2OK;
}
EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component s, const fmi2Reference r[], size_t n,
                                               const fmi2Integer order[], fmi2Real value[]) {
  (void)s, (void)r, (void)order, (void)value;
  return n ? fmi2Error : fmi2OK;
}
EXPORT fmi2Status fmi2DoStep(fmi2Component s, fmi2Real t, fmi2Real h, fmi2Boolean no_way_back) {
  (void)t, (void)no_way_back;
  advance(s, h);
  memset(s->slope, 0, sizeof s->slope);
  return finite_states(s) ? fmi2OK : fmi2Error;
}
EXPORT fmi2Status fmi2CancelStep(fmi2Component s) { (void)s; return fmi2Error; }
EXPORT fmi2Status fmi2GetStatus(fmi2Component s, int kind, fmi2Status* value) { (void)s, (void)kind, (void)value; return fmi2Discard; }
EXPORT fmi2Status fmi2GetRealStatus(fmi2Component s, int kind, fmi2Real* value) {
  if (kind != 2) return fmi2Discard;
  *value = s->m.t;
  return fmi2OK;
}
EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component s, int kind, fmi2Integer* value) { (void)s, (void)kind, (void)value; return fmi2Discard; }
EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component s, int kind, fmi2Boolean* value) {
  (void)s;
  if (kind != 3) return fmi2Discard;
  *value = 0;
  return fmi2OK;
}
EXPORT fmi2Status fmi2GetStringStatus(fmi2Component s, int kind, fmi2String* value) { (void)s, (void)kind, (void)value; return fmi2Discard; }
