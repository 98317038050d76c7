"""Take a trained network away: one ONNX file, a stock MuJoCo model, a page that needs no server."""
