"""The parts of a studio that know nothing of libraries: answers, guard of requests, uploads, its folder."""
