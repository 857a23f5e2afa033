/* A bicycle that rolls without slip, as an FMU 3.0 that can be told to fail. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
enum { STEERING, SPEED, X, Y, HEADING, WHEELBASE, FAILS, FAILS_FROM, GEAR, COUNT };
typedef struct { double v[COUNT], time; } Bicycle;

FMI const char *fmi3GetVersion(void) { return "3.0"; }
FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t required[], size_t count, void *environment,
                                      void *log, void *update) {
    Bicycle *b = calloc(1, sizeof *b);
    if (b) b->v[WHEELBASE] = 1.443;
    return b;
}
FMI int fmi3EnterInitializationMode(void *b, bool t, double tolerance, double start, bool s,
                                    double stop) { return 0; }
FMI int fmi3ExitInitializationMode(void *b) { return 0; }
FMI int fmi3Terminate(void *b) { return 0; }
FMI void fmi3FreeInstance(void *b) { free(b); }
FMI int fmi3SetFloat64(void *c, const uint32_t r[], size_t n, const double in[], size_t m) {
    for (size_t i = 0; i < n; ++i) ((Bicycle *)c)->v[r[i]] = in[i];
    return 0;
}
FMI int fmi3SetInt64(void *c, const uint32_t r[], size_t n, const int64_t in[], size_t m) {
    for (size_t i = 0; i < n; ++i) ((Bicycle *)c)->v[r[i]] = (double)in[i];
    return 0;
}
FMI int fmi3GetFloat64(void *c, const uint32_t r[], size_t n, double out[], size_t m) {
    for (size_t i = 0; i < n; ++i) out[i] = ((Bicycle *)c)->v[r[i]];
    return 0;
}
FMI int fmi3DoStep(void *c, double time, double step, bool no_set, bool *event, bool *ends,
                   bool *early, double *last) {
    Bicycle *b = c;
    double way = step * b->v[SPEED] * (b->v[GEAR] == 2.0 ? -1.0 : 1.0); /* 2: reverse */
    double turn = way * tan(b->v[STEERING] * M_PI / 180.0) / b->v[WHEELBASE];
    double middle = b->v[HEADING] + 0.5 * turn;
    b->v[X] += way * cos(middle);
    b->v[Y] += way * sin(middle);
    b->v[HEADING] += turn;
    *event = *early = false;
    *last = time + step;
    double fails = hypot(b->v[X], b->v[Y]) < b->v[FAILS_FROM] ? 0.0 : b->v[FAILS];
    *ends = fails == 1.0;
    if (fails == 2.0) b->v[X] = NAN;
    return fails == 3.0 ? 3 : 0;
}

/* FMPy wants every function of the standard to be there. */
#define ABSENT(name) FMI int fmi3##name(void) { return 3; }
ABSENT(ActivateModelPartition) ABSENT(CompletedIntegratorStep) ABSENT(DeserializeFMUState)
ABSENT(EnterConfigurationMode) ABSENT(EnterContinuousTimeMode) ABSENT(EnterEventMode)
ABSENT(EnterStepMode) ABSENT(EvaluateDiscreteStates) ABSENT(ExitConfigurationMode)
ABSENT(FreeFMUState) ABSENT(GetAdjointDerivative) ABSENT(GetBinary) ABSENT(GetBoolean)
ABSENT(GetClock) ABSENT(GetContinuousStateDerivatives) ABSENT(GetContinuousStates)
ABSENT(GetDirectionalDerivative) ABSENT(GetEventIndicators) ABSENT(GetFMUState)
ABSENT(GetFloat32) ABSENT(GetInt16) ABSENT(GetInt32) ABSENT(GetInt64) ABSENT(GetInt8)
ABSENT(GetIntervalDecimal) ABSENT(GetIntervalFraction) ABSENT(GetNominalsOfContinuousStates)
ABSENT(GetNumberOfContinuousStates) ABSENT(GetNumberOfEventIndicators)
ABSENT(GetNumberOfVariableDependencies) ABSENT(GetOutputDerivatives) ABSENT(GetShiftDecimal)
ABSENT(GetShiftFraction) ABSENT(GetString) ABSENT(GetUInt16) ABSENT(GetUInt32) ABSENT(GetUInt64)
ABSENT(GetUInt8) ABSENT(GetVariableDependencies) ABSENT(InstantiateModelExchange)
ABSENT(InstantiateScheduledExecution) ABSENT(Reset) ABSENT(SerializeFMUState)
ABSENT(SerializedFMUStateSize) ABSENT(SetBinary) ABSENT(SetBoolean) ABSENT(SetClock)
ABSENT(SetContinuousStates) ABSENT(SetDebugLogging) ABSENT(SetFMUState) ABSENT(SetFloat32)
ABSENT(SetInt16) ABSENT(SetInt32) ABSENT(SetInt8) ABSENT(SetIntervalDecimal)
ABSENT(SetIntervalFraction) ABSENT(SetShiftDecimal) ABSENT(SetShiftFraction) ABSENT(SetString)
ABSENT(SetTime) ABSENT(SetUInt16) ABSENT(SetUInt32) ABSENT(SetUInt64) ABSENT(SetUInt8)
ABSENT(UpdateDiscreteStates)
