/* FMI 3.0, co-simulation (fmi-standard.org); what this FMU does not have answers with an error. */
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#define EXPORT __attribute__((visibility("default")))
typedef enum { OK, Warning, Discard, Error, Fatal } Status;
typedef unsigned int Reference;

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT Status fmi3SetDebugLogging(void *m, bool on, size_t n, const char *const c[]) { return OK; }

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool events, bool early, const Reference required[], size_t n, void *environment, void *log, void *update)
{
    Model *m;
    if (!token || strcmp(token, TOKEN) || !(m = calloc(1, sizeof *m)))
        return NULL;
    memcpy(m->value, START, sizeof m->value);
    return m;
}
EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
    bool logging, void *environment, void *log) { return NULL; }
EXPORT void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible,
    bool logging, void *environment, void *log, void *update, void *lock, void *unlock) { return NULL; }
EXPORT void fmi3FreeInstance(void *m) { free(m); }

EXPORT Status fmi3EnterInitializationMode(void *m, bool tolerance, double t, double start, bool stop, double end)
{
    ((Model *)m)->value[TIME] = start;
    return OK;
}
EXPORT Status fmi3ExitInitializationMode(void *m) { initialise(m); return OK; }
EXPORT Status fmi3EnterEventMode(void *m) { return OK; }
EXPORT Status fmi3EnterStepMode(void *m) { return OK; }
EXPORT Status fmi3EnterConfigurationMode(void *m) { return Error; }
EXPORT Status fmi3ExitConfigurationMode(void *m) { return Error; }
EXPORT Status fmi3EnterContinuousTimeMode(void *m) { return Error; }
EXPORT Status fmi3Terminate(void *m) { return OK; }
EXPORT Status fmi3Reset(void *m)
{
    memset(m, 0, sizeof(Model));
    memcpy(((Model *)m)->value, START, sizeof START);
    return OK;
}

EXPORT Status fmi3DoStep(void *m, double now, double size, bool no_set, bool *event, bool *terminate, bool *early, double *last)
{
    if (size < 0.0)
        return Error;
    advance(m, llround((now + size) * 1e9));
    *event = *terminate = *early = false;
    *last = now + size;
    return isfinite(((Model *)m)->value[OUT_TENSION]) ? OK : Error;
}

EXPORT Status fmi3GetFloat64(void *m, const Reference r[], size_t n, double v[], size_t k)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= VARIABLES || r[i] == BRAKED)
            return Error;
        v[i] = ((Model *)m)->value[r[i]];
    }
    return OK;
}
EXPORT Status fmi3SetFloat64(void *m, const Reference r[], size_t n, const double v[], size_t k)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= VARIABLES || r[i] == BRAKED || r[i] < FIRST_SETTABLE || !isfinite(v[i]))
            return Error;
        ((Model *)m)->value[r[i]] = v[i];
    }
    return OK;
}
EXPORT Status fmi3GetBoolean(void *m, const Reference r[], size_t n, bool v[], size_t k)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] != BRAKED)
            return Error;
        v[i] = ((Model *)m)->value[BRAKED] != 0.0;
    }
    return OK;
}
EXPORT Status fmi3SetBoolean(void *m, const Reference r[], size_t n, const bool v[], size_t k)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] != BRAKED)
            return Error;
        ((Model *)m)->value[BRAKED] = v[i];
    }
    return OK;
}

/* The instance holds no pointer: a state is a copy of it. */
EXPORT Status fmi3GetFMUState(void *m, void **state)
{
    if (!*state && !(*state = malloc(sizeof(Model))))
        return Error;
    memcpy(*state, m, sizeof(Model));
    return OK;
}
EXPORT Status fmi3SetFMUState(void *m, void *state) { memcpy(m, state, sizeof(Model)); return OK; }
EXPORT Status fmi3FreeFMUState(void *m, void **state) { free(*state); *state = NULL; return OK; }
EXPORT Status fmi3SerializedFMUStateSize(void *m, void *state, size_t *size) { *size = sizeof(Model); return OK; }
EXPORT Status fmi3SerializeFMUState(void *m, void *state, unsigned char bytes[], size_t size)
{
    if (size < sizeof(Model))
        return Error;
    memcpy(bytes, state, sizeof(Model));
    return OK;
}
EXPORT Status fmi3DeserializeFMUState(void *m, const unsigned char bytes[], size_t size, void **state)
{
    if (size != sizeof(Model) || (!*state && !(*state = malloc(sizeof(Model)))))
        return Error;
    memcpy(*state, bytes, sizeof(Model));
    return OK;
}

/* What this FMU has not; C calls them with more arguments than they look at. */
#define ABSENT(name) EXPORT Status name(void *m) { return Error; }
ABSENT(fmi3GetFloat32) ABSENT(fmi3SetFloat32) ABSENT(fmi3GetInt8) ABSENT(fmi3SetInt8) ABSENT(fmi3GetUInt8)
ABSENT(fmi3SetUInt8) ABSENT(fmi3GetInt16) ABSENT(fmi3SetInt16) ABSENT(fmi3GetUInt16) ABSENT(fmi3SetUInt16)
ABSENT(fmi3GetInt32) ABSENT(fmi3SetInt32) ABSENT(fmi3GetUInt32) ABSENT(fmi3SetUInt32) ABSENT(fmi3GetInt64)
ABSENT(fmi3SetInt64) ABSENT(fmi3GetUInt64) ABSENT(fmi3SetUInt64) ABSENT(fmi3GetString) ABSENT(fmi3SetString)
ABSENT(fmi3GetBinary) ABSENT(fmi3SetBinary) ABSENT(fmi3GetClock) ABSENT(fmi3SetClock)
ABSENT(fmi3GetNumberOfVariableDependencies) ABSENT(fmi3GetVariableDependencies) ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative) ABSENT(fmi3GetIntervalDecimal) ABSENT(fmi3GetIntervalFraction)
ABSENT(fmi3GetShiftDecimal) ABSENT(fmi3GetShiftFraction) ABSENT(fmi3SetIntervalDecimal) ABSENT(fmi3SetIntervalFraction)
ABSENT(fmi3SetShiftDecimal) ABSENT(fmi3SetShiftFraction) ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates) ABSENT(fmi3CompletedIntegratorStep) ABSENT(fmi3SetTime)
ABSENT(fmi3SetContinuousStates) ABSENT(fmi3GetContinuousStateDerivatives) ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetContinuousStates) ABSENT(fmi3GetNominalsOfContinuousStates) ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates) ABSENT(fmi3GetOutputDerivatives) ABSENT(fmi3ActivateModelPartition)
