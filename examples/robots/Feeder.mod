MODULE Feeder
  ! Takes parts from the feeder (docs/guide/feeder.md) with a robot of ABB. A sketch by the maker's manual, not run on
  ! a robot: set address, zPick and pAbovePlate; CloseGripper, hasPart, LeavePlate and Place are yours.

  VAR socketdev feeder;

  FUNC string Ask(string command, num longest)
    VAR rawbytes data;
    VAR string line;
    SocketSend feeder \Str:=command + "\0A";
    SocketReceive feeder \RawData:=data \Time:=longest;
    IF RawBytesLen(data) > 80 THEN                 ! longest string; numbers come first
      UnpackRawBytes data, 1, line \ASCII:=80;
    ELSE
      UnpackRawBytes data, 1, line \ASCII:=RawBytesLen(data);
    ENDIF
    RETURN line;
  ENDFUNC

  FUNC num Number(string line, string name)
    VAR num begin;
    VAR num value;
    VAR bool ok;
    begin := StrMatch(line, 1, name) + StrLen(name);
    ok := StrToVal(StrPart(line, begin, StrMatch(line, begin, " ") - begin), value);
    RETURN value;
  ENDFUNC

  PROC Feed()
    VAR string line;
    VAR robtarget at;
    SocketCreate feeder;
    SocketConnect feeder, "192.168.0.2", 7171;
    WHILE TRUE DO
      line := Ask("get_part", 60);
      IF StrPart(line, 1, 4) = "200 " THEN
        at := pAbovePlate;                         ! for configuration and external axes
        at.trans := [Number(line, " x="), Number(line, " y="), zPick];
        at.rot := OrientZYX(Number(line, " angle="), 0, 180);
        MoveL Offs(at, 0, 0, 100), v1000, z10, tGripper \WObj:=wobjRobot;
        MoveL at, v200, fine, tGripper \WObj:=wobjRobot;
        CloseGripper;
        MoveL Offs(at, 0, 0, 100), v1000, z10, tGripper \WObj:=wobjRobot;
        LeavePlate;
        IF hasPart THEN
          line := Ask("part_taken ok", 5);
          Place;
        ELSE
          line := Ask("part_taken failed", 5);
        ENDIF
      ELSE
        TPWrite line;
        WaitTime 1;
      ENDIF
    ENDWHILE
  ENDPROC
ENDMODULE
