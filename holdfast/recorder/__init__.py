"""The recorder: trials on disk that survive whatever happens, laid out so that a person is one
folder.

    OUT/meta.json                                      whose format it is, unit, kind (recorded, simulated, replayed)
    OUT/<person>/<object>/meta.json                    its mass, where the protocol card says it
    OUT/<person>/<object>/<action>/trial_<n>/          <person>/nothing/trial_<n>/ for the empty hand
        tactile.csv            the samples, as they came (edge_runtime/tactile_file.py)
        meta.json              state, person, object, action, sensors, calibration, bias, versions, quality ..
        events.jsonl           marks and intervals with their provenance, and what happened
        tactile.truth.json     phases made of these (labels.py), of a kept trial
        camera.mkv, tags.csv.. where a camera watched (drivers/camera/recording.py)
    OUT/<person>/discarded/                            trials that were done again: moved here, never deleted

state: `recording` while it is (and after a kill), `kept`, `interrupted` (a signal, an error or the
end of the source ended it), `redone`, `void` (it ended before its header was written; holdfast
repair says so). Only kept trials are read by training, and count for the protocol.
"""
