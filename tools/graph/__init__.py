"""Run the real nodes as processes, watch them over DDS, judge and draw what they did."""
