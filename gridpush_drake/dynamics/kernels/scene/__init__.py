"""The compiled step and rollout of several bodies; `dynamics.kernels` has those of one.

They are compiled on the first push of several objects, and not before: whoever pushes one body
does not wait for them.
"""
