MODULE small
    ! 2 poses of ur10 planned for calibration, and 1 for its test.
    ! Joints as the controller counts them, at rest before every measurement.
    ! The plan ignores cables and the motion between poses:
    ! run it first at reduced speed with a hand on the emergency stop.

    PROC small_run()
        TPWrite "Mount 0 kg, set its load, then continue.";
        Stop;
        MoveAbsJ [[10.000,-20.500,30.125,0.000,45.000,170.000],[9E9,9E9,9E9,9E9,9E9,9E9]]\NoEOffs, v200, fine, tool0;
        measure_pose 1;
        TPWrite "Mount 2.5 kg, set its load, then continue.";
        Stop;
        MoveAbsJ [[-15.250,0.000,12.500,60.000,-30.001,90.000],[9E9,9E9,9E9,9E9,9E9,9E9]]\NoEOffs, v200, fine, tool0;
        measure_pose 2;
        MoveAbsJ [[0.000,5.000,-7.000,8.000,9.000,-110.999],[9E9,9E9,9E9,9E9,9E9,9E9]]\NoEOffs, v200, fine, tool0;
        measure_pose 3;
        TPWrite "All poses measured.";
    ENDPROC

    ! Trigger the measurement here, for example by a digital output.
    PROC measure_pose(num pose)
        WaitTime \InPos, 2;
        TPWrite "Pose " \Num:=pose;
    ENDPROC
ENDMODULE
