"""Several trainings in a few minutes on a lent GPU: data are made, networks trained one after another, all by a deadline.

    python -m vkdn.burst --plan plan.json --seconds 430 --out OUT

Each role is a process of its own, so that none takes the others down: the parent keeps the clock, `generate` renders procedural
crops into files, `train` reads them and trains. A training that dies is started again from its last saved weights, without what is
fast but new (graph, Triton).
"""
