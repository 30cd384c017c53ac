/* @title@
   A model that rotorid identified, in plain C99: no memory is allocated, nothing is printed, all numbers are SI.

   rid_model m;
   rid_defaults(&m);                      parameters, start and trim as identified
   m.start[RID_STATE_...] = ...;          where the flight begins; m.u[...] = the controls there
   rid_begin(&m, 0.0);                    states of effects come to rest under body states and controls
   rid_step(&m, u, 0.02);                 0.02 s further; the controls go straight from m.u to u
   m.y[RID_OUTPUT_...]                    what the sensors record; m.x are the states
*/
#ifndef RID_H
#define RID_H
#ifdef __cplusplus
extern "C" {
#endif

@sizes@

/* Samples that a delay looks back to. */
typedef struct {
  double t[RID_DEPTH], v[RID_DEPTH][RID_WIDE], spacing;
  int newest, count;
} rid_history;

/* One element of the way of controls or outputs: its size by channel, where a play stands at first, and its memory. */
typedef struct {
  double size[RID_WIDE], place[RID_WIDE], y[RID_WIDE], before[RID_WIDE];
  rid_history history;
} rid_element;

typedef struct {
  double theta[RID_THETA];         /* parameters, as rid_parameter_names; rid_prepare after a change */
  double start[RID_NX];            /* states at the beginning */
  double step;                     /* s: longest step of the integration (Runge-Kutta, 3/8 rule) */
  int settle;                      /* 1: states of effects begin at rest, whatever `start` says */
  int hold;                        /* 1: states stay at `start`; only the way of the controls goes on */
  double t, x[RID_NX], u[RID_NU];  /* s, states, controls as recorded */
  double v[RID_NU], y[RID_NY];     /* controls behind their way, outputs */
  double c[RID_NC];
  rid_element path[RID_PATHS + 1], record[RID_RECORDS + 1];
} rid_model;

extern const char* const rid_state_names[RID_NX];
extern const char* const rid_control_names[RID_NU];
extern const char* const rid_output_names[RID_NY];
extern const char* const rid_parameter_names[RID_NP + 1];

void rid_defaults(rid_model* m);
void rid_prepare(rid_model* m);
void rid_begin(rid_model* m, double t);
void rid_refresh(rid_model* m); /* outputs after the controls m->u have jumped */
void rid_step(rid_model* m, const double* u, double seconds);
void rid_rates(const rid_model* m, const double* x, const double* v, double* rates);     /* dx/dt */
void rid_outputs(const rid_model* m, const double* x, const double* v, double* outputs); /* of ideal sensors */

#ifdef __cplusplus
}
#endif
#endif
