"""Fuzzing of the readers: files that are nearly right, loaded one after the other.

    cd tests; python -m fuzz --reader gltf --seconds 1800 --findings /tmp/findings --log fuzz.jsonl

seeds.py makes good files of each format, mutate.py spoils them with regard to their structure,
harness.py has a worker process load, prepare and render them under limits and judges what happens.
A case is a pure function of reader, seed and number, unless --learn lets those that are refused
with words not seen before become seeds in turn.
"""
