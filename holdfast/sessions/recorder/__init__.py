"""The recorder: trials on disk that survive a crash; the recordings of a person are one folder.

    OUT/meta.json                         format, unit, kind (recorded, simulated, replayed)
    OUT/<person>/<object>/meta.json       the object's mass, if the protocol has it
    OUT/<person>/<object>/<action>/trial_<n>/   (<person>/nothing/trial_<n>/ for the empty hand)
        tactile.csv            the samples, as they came (holdfast/core/tactile_file.py)
        meta.json              state, person, object, action, calibration, bias, quality and more
        events.jsonl           marks and intervals with their provenance, and errors
        tactile.truth.json     of a kept trial: phases derived from these (labels.py)
        camera.mkv, tags.csv   with a camera (holdfast/drivers/camera/recording.py)
    OUT/<person>/discarded/    trials that were repeated: moved here, never deleted

state: `recording` meanwhile (and after a kill); `kept`; `interrupted` by a signal, an error or the
end of the source; `redone`; `void`, if it ended before its header was written (`check --repair`
sets it). Training reads only kept trials, and only these count for the protocol.
"""
