"""Runs the policies of a deploy bundle on a Go1 or Go2: needs numpy and onnxruntime, neither hts nor torch.

python -m hts_go1_runtime check BUNDLE
python -m hts_go1_runtime run BUNDLE --link udp://127.0.0.1:9870
"""
